//! Arrays of Python's: whatever has its buffer protocol, numpy's arrays and memoryviews of USD's memory among them.

use bytemuck::Pod;
use dermis::flat::array::{AnyArray, Lent, Scalar};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyMemoryView;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::{self, NonNull};
use std::sync::Arc;

/// An array as the core's: read in place where nobody can write to it, copied once elsewhere.
pub fn any_array(array: &Bound<'_, PyAny>) -> PyResult<AnyArray> {
    let memory = Memory::of(array)?;
    match memory.format()? {
        b"f" => taken(array, memory, Scalar::F32, AnyArray::F32),
        b"i" => taken(array, memory, Scalar::I32, AnyArray::I32),
        b"d" => taken(array, memory, Scalar::F64, AnyArray::F64),
        b"B" => taken(array, memory, Scalar::U8, AnyArray::U8),
        b"H" => taken(array, memory, Scalar::U16, AnyArray::U16),
        _ => Err(PyTypeError::new_err("arrays must be of float32, int32, float64, uint8 or uint16")),
    }
}

fn taken<T: Pod>(
    array: &Bound<'_, PyAny>,
    memory: Memory,
    scalar: Scalar,
    owned: fn(Vec<T>, usize) -> AnyArray,
) -> PyResult<AnyArray> {
    let components = memory.shape().iter().skip(1).product::<isize>() as usize;
    if !is_for_reading(array)? {
        return Ok(owned(memory.values::<T>()?.to_vec(), components));
    }
    let bytes = NonNull::from(bytemuck::cast_slice(memory.values::<T>()?));
    // SAFETY: the buffer keeps its memory, which `is_for_reading`.
    let memory = Arc::new(unsafe { Lent::new(bytes, Box::new(memory)) });
    Ok(AnyArray::Lent { memory, scalar, components })
}

/// Whether an array is a view of one of USD's: it cannot be made writeable, and USD copies on write what others read.
fn is_for_reading(array: &Bound<'_, PyAny>) -> PyResult<bool> {
    let view = if array.is_instance_of::<PyMemoryView>() { array.clone() } else { view_below(array)? };
    if !view.is_instance_of::<PyMemoryView>() {
        return Ok(false);
    }
    let module = view.getattr("obj")?.get_type().module()?;
    Ok(module == "pxr.Vt")
}

/// What a numpy array that cannot be written to is a view of.
fn view_below<'py>(array: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let writeable: bool = array.getattr("flags")?.getattr("writeable")?.extract()?;
    if writeable { Ok(array.py().None().into_bound(array.py())) } else { array.getattr("base") }
}

/// `Py_buffer`. Python's stable interface has it from 3.11 on, and 3.10 had the same.
#[repr(C)]
struct Buffer {
    start: *mut c_void,
    owner: *mut c_void,
    bytes: isize,
    item_size: isize,
    is_read_only: c_int,
    dimensions: c_int,
    format: *mut c_char,
    shape: *mut isize,
    strides: *mut isize,
    suboffsets: *mut isize,
    internal: *mut c_void,
}

const C_CONTIGUOUS: c_int = 0x0038;
const FORMAT: c_int = 0x0004;

unsafe extern "C" {
    fn PyObject_GetBuffer(object: *mut pyo3::ffi::PyObject, view: *mut Buffer, flags: c_int) -> c_int;
    fn PyBuffer_Release(view: *mut Buffer);
}

/// C-contiguous memory of an object, which is kept as long as this is.
struct Memory(Box<Buffer>);

// SAFETY: the memory may be read from everywhere; it is let go with the GIL.
unsafe impl Send for Memory {}
// SAFETY: as above.
unsafe impl Sync for Memory {}

impl Memory {
    fn of(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        let mut buffer = Box::new(Buffer {
            start: ptr::null_mut(),
            owner: ptr::null_mut(),
            bytes: 0,
            item_size: 0,
            is_read_only: 0,
            dimensions: 0,
            format: ptr::null_mut(),
            shape: ptr::null_mut(),
            strides: ptr::null_mut(),
            suboffsets: ptr::null_mut(),
            internal: ptr::null_mut(),
        });
        // SAFETY: the object is alive, and the GIL held. A buffer may point into itself: it stays in its box.
        match unsafe { PyObject_GetBuffer(object.as_ptr(), &raw mut *buffer, C_CONTIGUOUS | FORMAT) } {
            0 => Ok(Self(buffer)),
            _ => Err(PyErr::fetch(object.py())),
        }
    }

    /// As of Python's `struct`.
    fn format(&self) -> PyResult<&[u8]> {
        if self.0.format.is_null() {
            return Ok(b"B");
        }
        // SAFETY: text that ends in a zero, by the protocol.
        Ok(unsafe { CStr::from_ptr(self.0.format) }.to_bytes())
    }

    fn shape(&self) -> &[isize] {
        // SAFETY: as many as there are dimensions, as it was asked for.
        unsafe { std::slice::from_raw_parts(self.0.shape, self.0.dimensions as usize) }
    }

    fn values<T: Pod>(&self) -> PyResult<&[T]> {
        if self.0.bytes == 0 {
            return Ok(&[]);
        }
        // SAFETY: so many bytes in one piece, as it was asked for.
        let bytes = unsafe { std::slice::from_raw_parts(self.0.start.cast::<u8>(), self.0.bytes as usize) };
        bytemuck::try_cast_slice(bytes).map_err(|e| PyTypeError::new_err(format!("array: {e}")))
    }
}

impl Drop for Memory {
    /// At once: without the GIL, Python would be told when somebody next comes by with it, after the commit.
    fn drop(&mut self) {
        // SAFETY: got by `of`, and let go once.
        Python::try_attach(|_| unsafe { PyBuffer_Release(&raw mut *self.0) });
    }
}
