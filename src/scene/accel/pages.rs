//! Memory in pages of two megabytes, where the system has them: a ray that wanders through a large tree would
//! otherwise wait for page tables as often as for the tree (Embree asks for them, too).

/// Tables smaller than this gain nothing.
const LEAST: usize = 4 << 20;

pub(super) fn with_capacity<T>(capacity: usize) -> Vec<T> {
    let mut values: Vec<T> = Vec::with_capacity(capacity);
    if capacity * size_of::<T>() >= LEAST {
        advise(values.as_mut_ptr().cast(), capacity * size_of::<T>());
    }
    values
}

/// Must come before the memory is first written. Pages that are only in part of the range stay as they are.
#[cfg(target_os = "linux")]
fn advise(start: *mut u8, bytes: usize) {
    const PAGE: usize = 4096;
    let skipped = start.align_offset(PAGE);
    if bytes > skipped {
        // SAFETY: advice changes no contents, and the range is within one allocation. An error (a kernel without
        // huge pages) leaves ordinary ones.
        unsafe { libc::madvise(start.add(skipped).cast(), (bytes - skipped) & !(PAGE - 1), libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_: *mut u8, _: usize) {}

/// Gives back to the system what builds have freed: glibc keeps it, in an arena for each thread that took part.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn give_back() {
    // SAFETY: it touches free memory only.
    unsafe { libc::malloc_trim(0) };
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn give_back() {}
