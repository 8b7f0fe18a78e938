//! Embree 4 from a shared library that is loaded at run time: the few calls that the benchmark needs.

use dermis::math::Affine;
use dermis::scene::accel::Ray;
use glam::Vec3;
use libloading::Library;
use std::ffi::{c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::sync::atomic::{AtomicIsize, Ordering};

/// `RTCSceneFlags`: both modes of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(u32)]
pub enum Mode {
    Default = 0,
    Robust = 4,
}

type Handle = *mut c_void;
type Query<T> = unsafe extern "C" fn(Handle, *mut T, *mut c_void);

/// Values of Embree 4's enums that are used below.
const TRIANGLES: c_uint = 0;
const INSTANCE: c_uint = 121;
const INDEX: c_uint = 0;
const VERTEX: c_uint = 1;
const UINT3: c_uint = 0x5003;
const FLOAT3: c_uint = 0x9003;
const FLOAT3X4_COLUMN_MAJOR: c_uint = 0x9234;
const INVALID: u32 = u32::MAX;

/// `RTCRay`.
#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcRay {
    o: [f32; 3],
    t_near: f32,
    d: [f32; 3],
    time: f32,
    t_far: f32,
    mask: u32,
    id: u32,
    flags: u32,
}

/// `RTCRayHit`; the ids at the end are as many as any build of the library has.
#[repr(C, align(16))]
struct RtcRayHit {
    ray: RtcRay,
    ng: [f32; 3],
    u: f32,
    v: f32,
    triangle: u32,
    geometry: u32,
    instances: [u32; 9],
}

/// Bytes that all devices hold, as their memory monitor reports them.
static BYTES: AtomicIsize = AtomicIsize::new(0);

unsafe extern "C" fn monitor(_: *mut c_void, bytes: isize, _: bool) -> bool {
    BYTES.fetch_add(bytes, Ordering::Relaxed);
    true
}

pub struct Embree {
    /// Never unloaded: its threads end when they like.
    library: &'static Library,
    device: Handle,
    intersect: Query<RtcRayHit>,
    occluded: Query<RtcRay>,
}

/// A committed scene; freed with it.
pub struct EmbreeScene<'a> {
    embree: &'a Embree,
    scene: Handle,
    /// What its build left allocated, buffers of vertices and indices included.
    pub bytes: usize,
}

impl Embree {
    /// Loads the library and makes a device of one thread.
    ///
    /// # Errors
    /// What the loader or the device says.
    pub fn load(path: &Path) -> Result<Self, String> {
        // SAFETY: the library's initialisers are Embree's and TBB's, which expect to be loaded like this; the
        // signatures are those of embree4/rtcore_device.h and rtcore_scene.h.
        unsafe {
            let library = &*Box::leak(Box::new(Library::new(path).map_err(|e| e.to_string())?));
            let new_device: unsafe extern "C" fn(*const c_char) -> Handle = symbol(library, "rtcNewDevice")?;
            let device = new_device(c"threads=1".as_ptr());
            if device.is_null() {
                return Err("rtcNewDevice failed".into());
            }
            let (intersect, occluded) = (symbol(library, "rtcIntersect1")?, symbol(library, "rtcOccluded1")?);
            let embree = Self { library, device, intersect, occluded };
            let watch: unsafe extern "C" fn(
                Handle,
                unsafe extern "C" fn(*mut c_void, isize, bool) -> bool,
                *mut c_void,
            ) = embree.symbol("rtcSetDeviceMemoryMonitorFunction");
            watch(device, monitor, std::ptr::null_mut());
            Ok(embree)
        }
    }

    /// Like `4.4.0`, with the instruction set that it chose.
    pub fn version(&self) -> String {
        // SAFETY: RTC_DEVICE_PROPERTY_VERSION is 0; see `load`.
        let version = unsafe {
            self.symbol::<unsafe extern "C" fn(Handle, c_int) -> isize>("rtcGetDeviceProperty")(self.device, 0)
        };
        format!("{}.{}.{}", version / 10000, version / 100 % 100, version % 100)
    }

    /// # Safety
    /// `T` must be the type of the function.
    unsafe fn symbol<T: Copy>(&self, name: &str) -> T {
        // SAFETY: the caller's.
        unsafe { symbol(self.library, name) }.unwrap_or_else(|e| panic!("{e}"))
    }

    pub fn triangles(&self, mode: Mode, points: &[Vec3], triangles: &[[u32; 3]]) -> EmbreeScene<'_> {
        self.scene(mode, |add| {
            // SAFETY: the buffers are as long as asked for, of the formats' sizes.
            unsafe {
                let geometry = self.geometry(TRIANGLES);
                let buffer: unsafe extern "C" fn(Handle, c_uint, c_uint, c_uint, usize, usize) -> *mut c_void =
                    self.symbol("rtcSetNewGeometryBuffer");
                let to = buffer(geometry, VERTEX, 0, FLOAT3, 12, points.len());
                std::ptr::copy_nonoverlapping(points.as_ptr().cast(), to.cast::<Vec3>(), points.len());
                let to = buffer(geometry, INDEX, 0, UINT3, 12, triangles.len());
                std::ptr::copy_nonoverlapping(triangles.as_ptr(), to.cast::<[u32; 3]>(), triangles.len());
                add(geometry);
            }
        })
    }

    pub fn instances(&self, mode: Mode, of: &EmbreeScene, places: &[Affine]) -> EmbreeScene<'_> {
        self.scene(mode, |add| {
            for place in places {
                let columns = [place.linear.x_axis, place.linear.y_axis, place.linear.z_axis, place.translation];
                // SAFETY: twelve floats are read from `columns`.
                unsafe {
                    let geometry = self.geometry(INSTANCE);
                    self.symbol::<unsafe extern "C" fn(Handle, Handle)>("rtcSetGeometryInstancedScene")(
                        geometry, of.scene,
                    );
                    self.symbol::<unsafe extern "C" fn(Handle, c_uint, c_uint, *const c_void)>(
                        "rtcSetGeometryTransform",
                    )(geometry, 0, FLOAT3X4_COLUMN_MAJOR, columns.as_ptr().cast());
                    add(geometry);
                }
            }
        })
    }

    unsafe fn geometry(&self, kind: c_uint) -> Handle {
        // SAFETY: see `load`.
        unsafe { self.symbol::<unsafe extern "C" fn(Handle, c_uint) -> Handle>("rtcNewGeometry")(self.device, kind) }
    }

    /// A scene of the geometries that `fill` hands to its argument.
    fn scene(&self, mode: Mode, fill: impl FnOnce(&dyn Fn(Handle))) -> EmbreeScene<'_> {
        let before = BYTES.load(Ordering::Relaxed);
        // SAFETY: handles come from this device and are used once each; see `load`.
        let scene = unsafe {
            let scene = self.symbol::<unsafe extern "C" fn(Handle) -> Handle>("rtcNewScene")(self.device);
            self.symbol::<unsafe extern "C" fn(Handle, c_uint)>("rtcSetSceneFlags")(scene, mode as c_uint);
            let commit: unsafe extern "C" fn(Handle) = self.symbol("rtcCommitGeometry");
            let attach: unsafe extern "C" fn(Handle, Handle) -> c_uint = self.symbol("rtcAttachGeometry");
            let release: unsafe extern "C" fn(Handle) = self.symbol("rtcReleaseGeometry");
            fill(&|geometry| {
                commit(geometry);
                attach(scene, geometry);
                release(geometry);
            });
            self.symbol::<unsafe extern "C" fn(Handle)>("rtcCommitScene")(scene);
            scene
        };
        self.check();
        EmbreeScene { embree: self, scene, bytes: (BYTES.load(Ordering::Relaxed) - before).max(0) as usize }
    }

    /// Panics with Embree's message after an error: the numbers would mean nothing.
    fn check(&self) {
        // SAFETY: see `load`; the message is a C string with the life of the device.
        unsafe {
            let error = self.symbol::<unsafe extern "C" fn(Handle) -> c_int>("rtcGetDeviceError")(self.device);
            assert!(error == 0, "Embree reports error {error}");
        }
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: scenes borrow the device, so none is left.
        unsafe { self.symbol::<unsafe extern "C" fn(Handle)>("rtcReleaseDevice")(self.device) };
    }
}

impl Drop for EmbreeScene<'_> {
    fn drop(&mut self) {
        // SAFETY: the handle is released once; a scene that others instance is counted by Embree.
        unsafe { self.embree.symbol::<unsafe extern "C" fn(Handle)>("rtcReleaseScene")(self.scene) };
    }
}

impl EmbreeScene<'_> {
    /// t of the closest hit; infinite without one.
    #[inline]
    pub fn closest(&self, ray: &Ray) -> f32 {
        let mut query = RtcRayHit {
            ray: rtc(ray),
            ng: [0.0; 3],
            u: 0.0,
            v: 0.0,
            triangle: INVALID,
            geometry: INVALID,
            instances: [INVALID; 9],
        };
        // SAFETY: the scene is committed and the query laid out as `RTCRayHit`; null arguments are the defaults.
        unsafe { (self.embree.intersect)(self.scene, &mut query, std::ptr::null_mut()) };
        if query.geometry == INVALID { f32::INFINITY } else { query.ray.t_far }
    }

    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        let mut query = rtc(ray);
        // SAFETY: as above; Embree sets t_far to -inf where something is hit.
        unsafe { (self.embree.occluded)(self.scene, &mut query, std::ptr::null_mut()) };
        query.t_far < 0.0
    }
}

fn rtc(ray: &Ray) -> RtcRay {
    RtcRay {
        o: ray.o.to_array(),
        t_near: 0.0,
        d: ray.d.to_array(),
        time: 0.0,
        t_far: ray.t_max,
        mask: u32::MAX,
        id: 0,
        flags: 0,
    }
}

/// # Safety
/// `T` must be the type of the function.
unsafe fn symbol<T: Copy>(library: &Library, name: &str) -> Result<T, String> {
    // SAFETY: the caller's.
    unsafe { library.get::<T>(name.as_bytes()) }.map(|f| *f).map_err(|e| e.to_string())
}
