use super::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Says when it goes.
struct Owner(Vec<f32>, Arc<AtomicBool>);

impl Drop for Owner {
    fn drop(&mut self) {
        self.1.store(true, Ordering::Relaxed);
    }
}

fn lend(values: Vec<f32>, skipped: usize, gone: &Arc<AtomicBool>) -> AnyArray {
    let owner = Box::new(Owner(values, gone.clone()));
    let bytes = NonNull::from(&bytemuck::cast_slice::<f32, u8>(&owner.0)[skipped..]);
    // SAFETY: moving the box does not move what its vector has, and nobody writes to it.
    let memory = Arc::new(unsafe { Lent::new(bytes, owner) });
    AnyArray::Lent { memory, scalar: Scalar::F32, components: 3 }
}

#[test]
fn lent_memory_is_read_in_place_and_kept_as_long_as_an_array_has_it() {
    let gone = Arc::new(AtomicBool::new(false));
    let values = vec![1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0];
    let place = values.as_ptr();
    let array: Array<[f32; 3]> = lend(values, 0, &gone).into_array().unwrap();
    let other = array.clone();
    assert_eq!((&*array, array.as_ptr().cast()), (&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]][..], place));
    drop(array);
    assert!(!gone.load(Ordering::Relaxed) && other[1] == [4.0, 5.0, 6.0]);
    drop(other);
    assert!(gone.load(Ordering::Relaxed));
}

#[test]
fn lent_memory_that_is_not_aligned_is_copied_and_parts_of_elements_are_refused() {
    let gone = Arc::new(AtomicBool::new(false));
    // Shifted by two bytes in a buffer that is four times too large: 22 = 12 + 10 is refused, 12 is copied.
    assert!(lend(vec![0.0; 6], 2, &gone).into_array::<[f32; 3]>().is_err());
    let shifted: Vec<u8> =
        [vec![0; 2], bytemuck::cast_slice::<f32, u8>(&[1.0, 2.0, 3.0]).to_vec(), vec![0; 2]].concat();
    let aligned: Vec<f32> = shifted.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect();
    let owner = Box::new(Owner(aligned, gone.clone()));
    let bytes = NonNull::from(&bytemuck::cast_slice::<f32, u8>(&owner.0)[2..14]);
    // SAFETY: as above.
    let memory = Arc::new(unsafe { Lent::new(bytes, owner) });
    let array = AnyArray::Lent { memory, scalar: Scalar::F32, components: 3 }.into_array::<[f32; 3]>().unwrap();
    assert_eq!(*array, [[1.0, 2.0, 3.0]]);
    assert!(gone.load(Ordering::Relaxed));
}

#[test]
fn what_is_serialised_is_in_memory_once() {
    let array = Array::from(vec![[1.0_f32, 2.0, 3.0]; 4]);
    let (text, arrays) = collect_arrays(|| serde_json::to_string(&array).unwrap());
    assert_eq!((text.as_str(), arrays[0].len(), arrays[0].components()), (r#"{"array":0}"#, 4, 3));
    assert_eq!(arrays[0].bytes().as_ptr(), array.as_ptr().cast());
    drop(array);
    let again: Array<[f32; 3]> = with_arrays(arrays, || serde_json::from_str(&text)).unwrap();
    assert_eq!(*again, [[1.0, 2.0, 3.0]; 4]);
}
