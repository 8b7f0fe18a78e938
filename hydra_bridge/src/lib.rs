//! The Python module `dermis._core`: the render delegate with arrays in and out.

mod arrays;

use arrays::any_array;
use dermis::delegate::{DirtyBits, LayerSpec, RenderDelegate, xy};
use dermis::error::{Error, Warning};
use dermis::flat::array::with_arrays;
use dermis::flat::{self, Prim, RenderSettings, StageInfo};
use dermis::output::{Attribute, Frame, Layer, Samples, write_exr};
use dermis::subsurface::inversion::{self, Illumination};
use numpy::{PyArray3, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

pyo3::create_exception!(_core, CoreError, pyo3::exceptions::PyException);

fn core_error(error: Error) -> PyErr {
    CoreError::new_err(error.to_string())
}

fn json_error(what: &str, error: serde_json::Error) -> PyErr {
    PyValueError::new_err(format!("{what}: {error}"))
}

/// The delegate behind a lock: several Python threads may hold one, and each call waits for its turn.
#[pyclass(frozen)]
struct Delegate {
    core: Mutex<RenderDelegate>,
}

impl Delegate {
    fn of(core: RenderDelegate) -> Self {
        Self { core: Mutex::new(core) }
    }

    /// Runs `call` with the GIL released: who waits for the lock must not hold what its owner may need.
    fn with<T: Send>(&self, py: Python<'_>, call: impl FnOnce(&mut RenderDelegate) -> T + Send) -> T {
        // A panic inside of a call left a description that validation still guards.
        py.detach(|| call(&mut self.core.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl Delegate {
    #[new]
    fn new() -> Self {
        Self::of(RenderDelegate::new())
    }

    #[staticmethod]
    fn load(py: Python<'_>, file: PathBuf) -> PyResult<Self> {
        py.detach(|| flat::file::load(&file).map(|scene| Self::of(RenderDelegate::from_flat(scene))))
            .map_err(core_error)
    }

    fn save(&self, py: Python<'_>, file: PathBuf) -> PyResult<()> {
        self.with(py, |core| core.whole().and_then(|scene| flat::file::save(scene, &file))).map_err(core_error)
    }

    fn sync(
        &self,
        py: Python<'_>,
        path: &str,
        prim: &str,
        arrays: Vec<Bound<'_, PyAny>>,
        dirty_bits: u32,
    ) -> PyResult<()> {
        let arrays = arrays.iter().map(any_array).collect::<PyResult<Vec<_>>>()?;
        let prim: Prim = with_arrays(arrays, || serde_json::from_str(prim)).map_err(|e| json_error(path, e))?;
        self.with(py, |core| core.sync(path, prim, DirtyBits::from_bits_truncate(dirty_bits)));
        Ok(())
    }

    fn remove(&self, py: Python<'_>, path: &str) {
        self.with(py, |core| core.remove(path));
    }

    fn set_stage(&self, py: Python<'_>, info: &str) -> PyResult<()> {
        let info: StageInfo = serde_json::from_str(info).map_err(|e| json_error("stage", e))?;
        self.with(py, |core| core.set_stage(info));
        Ok(())
    }

    fn set_settings(&self, py: Python<'_>, settings: &str) -> PyResult<()> {
        let edit: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(settings).map_err(|e| json_error("settings", e))?;
        self.with(py, |core| {
            let current = serde_json::to_value(core.settings()).map_err(|e| json_error("settings", e))?;
            let serde_json::Value::Object(mut merged) = current else {
                return Err(PyValueError::new_err("settings: not an object"));
            };
            merged.extend(edit);
            let settings: RenderSettings =
                serde_json::from_value(merged.into()).map_err(|e| json_error("settings", e))?;
            core.set_settings(settings).map_err(core_error)
        })
    }

    fn settings(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |core| serde_json::to_string(core.settings())).map_err(|e| json_error("settings", e))
    }

    fn clear_warnings(&self, py: Python<'_>) {
        self.with(py, RenderDelegate::clear_warnings);
    }

    fn warn(&self, py: Python<'_>, path: &str, message: &str) {
        self.with(py, |core| core.warn(Warning::new(path, message)));
    }

    #[pyo3(signature = (last = false))]
    fn commit(&self, py: Python<'_>, last: bool) -> PyResult<String> {
        let commit = if last { RenderDelegate::commit_last } else { RenderDelegate::commit };
        let stats = self.with(py, commit).map_err(core_error)?;
        serde_json::to_string(&stats).map_err(|e| json_error("commit", e))
    }

    fn explain(&self, py: Python<'_>) -> String {
        self.with(py, |core| core.explain().to_string())
    }

    fn bounds(&self, py: Python<'_>) -> Option<(Vec<f64>, Vec<f64>)> {
        self.with(py, |core| core.bounds()).map(|(min, max)| (min.to_vec(), max.to_vec()))
    }

    fn cameras(&self, py: Python<'_>) -> Vec<String> {
        self.with(py, |core| core.flat().cameras.keys().cloned().collect())
    }

    #[pyo3(signature = (checkpoint = None, every = 0.0, resume = false))]
    fn start(
        &self,
        py: Python<'_>,
        checkpoint: Option<PathBuf>,
        every: f64,
        resume: bool,
    ) -> PyResult<Option<PathBuf>> {
        let every = Duration::try_from_secs_f64(every).map_err(|e| PyValueError::new_err(format!("every: {e}")))?;
        let started = self.with(py, |core| match checkpoint {
            Some(file) => core.start_with_checkpoints(file, every, resume),
            None => core.start().map(|()| None),
        });
        started.map_err(core_error)
    }

    fn poll(&self, py: Python<'_>) -> PyResult<(f64, bool)> {
        self.with(py, RenderDelegate::poll).map_err(core_error)
    }

    fn wait(&self, py: Python<'_>, seconds: f64) -> PyResult<bool> {
        let end = Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 3600.0));
        loop {
            let (_, finished) = self.poll(py)?;
            if finished || Instant::now() >= end {
                return Ok(finished);
            }
            py.detach(|| std::thread::sleep(Duration::from_millis(5)));
            py.check_signals()?;
        }
    }

    fn stop(&self, py: Python<'_>) {
        self.with(py, RenderDelegate::stop);
    }

    fn snapshot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (width, height, planes) = self.with(py, |core| core.snapshot());
        let aovs = PyDict::new(py);
        for plane in planes {
            let flat = numpy::PyArray1::from_vec(py, plane.values);
            let shape = [height as usize, width as usize, plane.channels];
            let image: Bound<'py, PyArray3<f32>> = flat.reshape(shape)?;
            aovs.set_item(&*plane.name, image)?;
        }
        Ok(aovs)
    }

    fn check(&self, py: Python<'_>) -> (bool, bool) {
        self.with(py, |core| core.check())
    }

    fn stats(&self, py: Python<'_>) -> String {
        self.with(py, |core| core.stats().to_string())
    }

    #[pyo3(signature = (file, attributes, layers = None))]
    fn write_exr(&self, py: Python<'_>, file: PathBuf, attributes: &str, layers: Option<&str>) -> PyResult<()> {
        let attributes = serde_json::from_str(attributes).map_err(|e| json_error("attributes", e))?;
        let layers: Option<Vec<LayerSpec>> =
            layers.map(serde_json::from_str).transpose().map_err(|e| json_error("layers", e))?;
        self.with(py, |core| core.write_exr(&file, attributes, layers.as_deref())).map_err(core_error)
    }
}

/// The single-scattering albedo that shows `color` behind a boundary; see [`dermis::subsurface::inversion`].
#[pyfunction]
fn single_scattering_albedo(color: [f32; 3], anisotropy: f32, eta: f32, dielectric: bool) -> [f32; 3] {
    let illumination = if dielectric { Illumination::Normal } else { Illumination::Diffuse };
    inversion::single_scattering_albedo(color.into(), anisotropy, eta, illumination).into()
}

/// Writes channels, rows from the top, as the renderer writes its own images; see [`dermis::output`].
/// `frame`: resolution, data origin and data size in pixels, pixel aspect ratio.
#[pyfunction]
fn write_channels(
    py: Python<'_>,
    file: PathBuf,
    frame: ([u32; 2], [i32; 2], [u32; 2], f32),
    channels: Vec<(String, Bound<'_, PyAny>)>,
    attributes: &str,
) -> PyResult<()> {
    let (resolution, data_origin, data_size, pixel_aspect_ratio) = frame;
    let frame = Frame { resolution, data_origin, data_size, pixel_aspect_ratio };
    let attributes: BTreeMap<String, serde_json::Value> =
        serde_json::from_str(attributes).map_err(|e| json_error("attributes", e))?;
    let attributes: Vec<_> = attributes
        .into_iter()
        .map(|(name, value)| match xy(&name, &value) {
            Some(xy) => (name, Attribute::Chromaticities(xy)),
            None => (name, attribute(value)),
        })
        .collect();
    let layers = channels.iter().map(|(name, values)| {
        let samples = if let Ok(values) = values.extract::<PyReadonlyArrayDyn<'_, u32>>() {
            Samples::U32(values.as_array().iter().copied().collect())
        } else {
            let values = values.extract::<PyReadonlyArrayDyn<'_, f32>>();
            let values = values.map_err(|_| PyTypeError::new_err(format!("{name}: float32 or uint32 is wanted")))?;
            Samples::F32(values.as_array().iter().copied().collect())
        };
        Ok(Layer { name: String::new(), channels: vec![(name.as_str(), samples)] })
    });
    let layers = layers.collect::<PyResult<Vec<_>>>()?;
    py.detach(|| write_exr(&file, &frame, layers, &attributes)).map_err(core_error)
}

/// A value of metadata: whole numbers, other numbers, or text.
fn attribute(value: serde_json::Value) -> Attribute {
    match (value.as_i64(), value.as_f64()) {
        (Some(whole), _) if i32::try_from(whole).is_ok() => Attribute::Int(whole as i32),
        (_, Some(number)) => Attribute::Float(number as f32),
        _ => Attribute::Text(value.as_str().map_or_else(|| value.to_string(), str::to_owned)),
    }
}

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("CoreError", m.py().get_type::<CoreError>())?;
    m.add_function(wrap_pyfunction!(single_scattering_albedo, m)?)?;
    m.add_function(wrap_pyfunction!(write_channels, m)?)?;
    m.add_class::<Delegate>()
}
