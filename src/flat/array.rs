//! Arrays of the flattened scene: owned, a view into a memory-mapped `.dermis` file, or memory of the caller's.
//!
//! serde carries numbers well but big arrays badly, so an [`Array`] serialises as its index into a
//! table that rides beside the text for the length of one call ([`with_arrays`], [`collect_arrays`]).
//! The same mechanism serves the file on disk and the bridge, where the table holds numpy arrays.

use bytemuck::Pod;
use memmap2::Mmap;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use std::{cell::RefCell, ops::Deref, ptr::NonNull, sync::Arc};

/// Scalar type of an array's elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scalar {
    F32,
    F64,
    I32,
    U8,
    U16,
}

impl Scalar {
    pub fn size(self) -> usize {
        match self {
            Scalar::F32 | Scalar::I32 => 4,
            Scalar::F64 => 8,
            Scalar::U8 => 1,
            Scalar::U16 => 2,
        }
    }
}

/// Element of an [`Array`]: a scalar, a vector or a matrix of one scalar type.
pub trait Element: Pod + Send + Sync {
    const SCALAR: Scalar;
    const COMPONENTS: usize;
}

macro_rules! element {
    ($($t:ty: $scalar:ident x $n:expr),* $(,)?) => {
        $(impl Element for $t {
            const SCALAR: Scalar = Scalar::$scalar;
            const COMPONENTS: usize = $n;
        })*
    };
}
element!(f32: F32 x 1, [f32; 2]: F32 x 2, [f32; 3]: F32 x 3, [f32; 4]: F32 x 4, f64: F64 x 1, i32: I32 x 1,
    u8: U8 x 1, u16: U16 x 1, [[f64; 4]; 4]: F64 x 16);

/// An immutable array of `T`, cheap to clone.
#[derive(Debug, Clone)]
pub struct Array<T>(Storage<T>);

#[derive(Debug, Clone)]
enum Storage<T> {
    Owned(Arc<Vec<T>>),
    /// Bytes `offset..offset + len * size_of::<T>()` of the map; aligned for `T` (checked on load).
    Mapped {
        map: Arc<Mmap>,
        offset: usize,
        len: usize,
    },
    /// Whole elements, aligned for `T` (checked where it is made).
    Lent(Arc<Lent>),
}

/// Memory of the caller's that is read in place: a copy of a large mesh is not made for each who holds it.
pub struct Lent {
    bytes: NonNull<[u8]>,
    /// What keeps the memory.
    _owner: Box<dyn Send + Sync>,
}

// SAFETY: the bytes are only read, by the promise to `Lent::new` by everyone.
unsafe impl Send for Lent {}
// SAFETY: as above.
unsafe impl Sync for Lent {}

impl Lent {
    /// # Safety
    /// While `owner` lives, `bytes` are there and nobody writes to them.
    pub unsafe fn new(bytes: NonNull<[u8]>, owner: Box<dyn Send + Sync>) -> Self {
        Self { bytes, _owner: owner }
    }

    fn bytes(&self) -> &[u8] {
        // SAFETY: the promise to `new`; the owner lives as long as `self`.
        unsafe { self.bytes.as_ref() }
    }
}

impl std::fmt::Debug for Lent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Lent({} bytes)", self.bytes.len())
    }
}

impl<T> Default for Array<T> {
    fn default() -> Self {
        Self(Storage::Owned(Arc::default()))
    }
}

impl<T: Element> Array<T> {
    /// `len` elements of a map from byte `offset` on, which is a multiple of 64.
    ///
    /// # Panics
    /// Where they are not inside of the map.
    pub fn mapped(map: Arc<Mmap>, offset: usize, len: usize) -> Self {
        assert!(offset.is_multiple_of(64) && offset + len * size_of::<T>() <= map.len());
        Self(Storage::Mapped { map, offset, len })
    }

    /// Its memory, for as long as somebody has it.
    fn lend(&self) -> Arc<Lent> {
        let bytes = NonNull::from(bytemuck::cast_slice::<T, u8>(self));
        match &self.0 {
            // SAFETY: each keeps the memory, and arrays are immutable.
            Storage::Owned(values) => Arc::new(unsafe { Lent::new(bytes, Box::new(Arc::clone(values))) }),
            // SAFETY: as above.
            Storage::Mapped { map, .. } => Arc::new(unsafe { Lent::new(bytes, Box::new(Arc::clone(map))) }),
            Storage::Lent(memory) => Arc::clone(memory),
        }
    }

    /// Map, and range in bytes, of an array that is not in memory of its own.
    pub fn map(&self) -> Option<(&Mmap, usize, usize)> {
        match &self.0 {
            Storage::Owned(_) | Storage::Lent(_) => None,
            Storage::Mapped { map, offset, len } => Some((map, *offset, *len * size_of::<T>())),
        }
    }
}

impl<T> From<Vec<T>> for Array<T> {
    fn from(values: Vec<T>) -> Self {
        Self(Storage::Owned(Arc::new(values)))
    }
}

impl<T: Element> Deref for Array<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        match &self.0 {
            Storage::Owned(values) => values,
            Storage::Mapped { map, offset, len } => {
                bytemuck::cast_slice(&map[*offset..*offset + *len * size_of::<T>()])
            }
            Storage::Lent(memory) => bytemuck::cast_slice(memory.bytes()),
        }
    }
}

impl<T: Element + PartialEq> PartialEq for Array<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

/// One entry of the table beside the text.
#[derive(Debug, Clone)]
pub enum AnyArray {
    F32(Vec<f32>, usize),
    F64(Vec<f64>, usize),
    I32(Vec<i32>, usize),
    U8(Vec<u8>, usize),
    U16(Vec<u16>, usize),
    Mapped { map: Arc<Mmap>, offset: usize, len: usize, scalar: Scalar, components: usize },
    Lent { memory: Arc<Lent>, scalar: Scalar, components: usize },
}

impl AnyArray {
    pub fn scalar(&self) -> Scalar {
        match self {
            AnyArray::F32(..) => Scalar::F32,
            AnyArray::F64(..) => Scalar::F64,
            AnyArray::I32(..) => Scalar::I32,
            AnyArray::U8(..) => Scalar::U8,
            AnyArray::U16(..) => Scalar::U16,
            AnyArray::Mapped { scalar, .. } | AnyArray::Lent { scalar, .. } => *scalar,
        }
    }

    /// Scalars per element.
    pub fn components(&self) -> usize {
        match self {
            AnyArray::F32(_, n) | AnyArray::F64(_, n) | AnyArray::I32(_, n) => *n,
            AnyArray::U8(_, n) | AnyArray::U16(_, n) => *n,
            AnyArray::Mapped { components, .. } | AnyArray::Lent { components, .. } => *components,
        }
    }

    /// The raw little-endian bytes.
    pub fn bytes(&self) -> &[u8] {
        match self {
            AnyArray::F32(values, _) => bytemuck::cast_slice(values),
            AnyArray::F64(values, _) => bytemuck::cast_slice(values),
            AnyArray::I32(values, _) => bytemuck::cast_slice(values),
            AnyArray::U8(values, _) => values,
            AnyArray::U16(values, _) => bytemuck::cast_slice(values),
            AnyArray::Mapped { map, offset, len, scalar, components } => {
                &map[*offset..*offset + *len * scalar.size() * *components]
            }
            AnyArray::Lent { memory, .. } => memory.bytes(),
        }
    }

    /// Elements (not scalars).
    pub fn len(&self) -> usize {
        self.bytes().len() / (self.scalar().size() * self.components()).max(1)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The array as elements of `T`, without a copy where the allocation allows it.
    fn into_array<T: Element>(self) -> std::result::Result<Array<T>, String> {
        if self.scalar() != T::SCALAR || self.components() != T::COMPONENTS {
            return Err(format!(
                "array of {:?} x {} where {:?} x {} was expected",
                self.scalar(),
                self.components(),
                T::SCALAR,
                T::COMPONENTS
            ));
        }
        match self {
            AnyArray::F32(values, _) => cast_vec(values),
            AnyArray::F64(values, _) => cast_vec(values),
            AnyArray::I32(values, _) => cast_vec(values),
            AnyArray::U8(values, _) => cast_vec(values),
            AnyArray::U16(values, _) => cast_vec(values),
            AnyArray::Mapped { map, offset, len, .. } => Ok(Array(Storage::Mapped { map, offset, len })),
            AnyArray::Lent { memory, .. } => lent(memory),
        }
    }
}

/// In place; copied where it is not aligned for its elements.
fn lent<T: Element>(memory: Arc<Lent>) -> std::result::Result<Array<T>, String> {
    let bytes = memory.bytes();
    if bytemuck::try_cast_slice::<u8, T>(bytes).is_ok() {
        return Ok(Array(Storage::Lent(memory)));
    }
    if !bytes.len().is_multiple_of(size_of::<T>()) {
        return Err(format!("array of {} bytes where elements have {}", bytes.len(), size_of::<T>()));
    }
    let values: Vec<T> = bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect();
    Ok(values.into())
}

fn cast_vec<A: Pod, T: Element>(values: Vec<A>) -> std::result::Result<Array<T>, String> {
    match bytemuck::try_cast_vec(values) {
        Ok(values) => Ok(values.into()),
        // A spare capacity that is no whole number of elements: copy.
        Err((_, values)) => bytemuck::try_cast_slice(&values)
            .map(|values: &[T]| values.to_vec().into())
            .map_err(|e| format!("array whose length does not fit its element: {e}")),
    }
}

thread_local! {
    static TABLE: RefCell<Vec<Option<AnyArray>>> = const { RefCell::new(Vec::new()) };
}

/// Runs `f` (a deserialisation) with `arrays` as the table that [`Array`] indices refer to.
pub fn with_arrays<R>(arrays: Vec<AnyArray>, f: impl FnOnce() -> R) -> R {
    TABLE.with_borrow_mut(|table| *table = arrays.into_iter().map(Some).collect());
    let result = f();
    TABLE.with_borrow_mut(Vec::clear);
    result
}

/// Runs `f` (a serialisation) and returns the arrays met, in the order of their indices.
pub fn collect_arrays<R>(f: impl FnOnce() -> R) -> (R, Vec<AnyArray>) {
    TABLE.with_borrow_mut(Vec::clear);
    let result = f();
    (result, TABLE.with_borrow_mut(std::mem::take).into_iter().flatten().collect())
}

#[derive(Serialize, Deserialize)]
struct ArrayIndex {
    array: usize,
}

impl<T: Element> Serialize for Array<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let entry = AnyArray::Lent { memory: self.lend(), scalar: T::SCALAR, components: T::COMPONENTS };
        let array = TABLE.with_borrow_mut(|table| {
            table.push(Some(entry));
            table.len() - 1
        });
        ArrayIndex { array }.serialize(serializer)
    }
}

impl<'de, T: Element> Deserialize<'de> for Array<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let index = ArrayIndex::deserialize(deserializer)?.array;
        let entry = TABLE.with_borrow_mut(|table| table.get_mut(index).and_then(Option::take));
        let entry = entry.ok_or_else(|| D::Error::custom(format!("array {index} is not in the table")))?;
        entry.into_array().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests;
