//! The Python module `dermis._core`: the render delegate with numpy arrays in and out.

use dermis::delegate::{DirtyBits, RenderDelegate};
use dermis::error::{Error, Warning};
use dermis::flat::{self, Prim, RenderSettings, StageInfo, array::AnyArray, array::with_arrays};
use dermis::subsurface::inversion::{self, Illumination};
use numpy::{PyArray3, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pyo3::create_exception!(_core, CoreError, pyo3::exceptions::PyException);

fn core_error(error: Error) -> PyErr {
    CoreError::new_err(error.to_string())
}

fn json_error(what: &str, error: serde_json::Error) -> PyErr {
    PyValueError::new_err(format!("{what}: {error}"))
}

#[pyclass]
struct Delegate {
    core: RenderDelegate,
}

#[pymethods]
impl Delegate {
    #[new]
    fn new() -> Self {
        Self { core: RenderDelegate::new() }
    }

    #[staticmethod]
    fn load(file: PathBuf) -> PyResult<Self> {
        let scene = flat::file::load(&file).map_err(core_error)?;
        Ok(Self { core: RenderDelegate::from_flat(scene) })
    }

    fn save(&self, file: PathBuf) -> PyResult<()> {
        flat::file::save(self.core.flat(), &file).map_err(core_error)
    }

    fn sync(&mut self, path: &str, prim: &str, arrays: Vec<Bound<'_, PyAny>>, dirty_bits: u32) -> PyResult<()> {
        let arrays = arrays.iter().map(any_array).collect::<PyResult<Vec<_>>>()?;
        let prim: Prim = with_arrays(arrays, || serde_json::from_str(prim)).map_err(|e| json_error(path, e))?;
        self.core.sync(path, prim, DirtyBits::from_bits_truncate(dirty_bits));
        Ok(())
    }

    fn remove(&mut self, path: &str) {
        self.core.remove(path);
    }

    fn set_stage(&mut self, info: &str) -> PyResult<()> {
        let info: StageInfo = serde_json::from_str(info).map_err(|e| json_error("stage", e))?;
        self.core.set_stage(info);
        Ok(())
    }

    fn set_settings(&mut self, settings: &str) -> PyResult<()> {
        let edit: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(settings).map_err(|e| json_error("settings", e))?;
        let current = serde_json::to_value(self.core.settings()).map_err(|e| json_error("settings", e))?;
        let serde_json::Value::Object(mut merged) = current else {
            return Err(PyValueError::new_err("settings: not an object"));
        };
        merged.extend(edit);
        let settings: RenderSettings = serde_json::from_value(merged.into()).map_err(|e| json_error("settings", e))?;
        self.core.set_settings(settings).map_err(core_error)
    }

    fn settings(&self) -> PyResult<String> {
        serde_json::to_string(self.core.settings()).map_err(|e| json_error("settings", e))
    }

    fn warn(&mut self, path: &str, message: &str) {
        self.core.warn(Warning::new(path, message));
    }

    fn commit(&mut self, py: Python<'_>) -> PyResult<String> {
        let core = &mut self.core;
        let stats = py.detach(|| core.commit()).map_err(core_error)?;
        serde_json::to_string(&stats).map_err(|e| json_error("commit", e))
    }

    fn explain(&self) -> String {
        self.core.explain().to_string()
    }

    fn bounds(&self) -> Option<(Vec<f64>, Vec<f64>)> {
        self.core.bounds().map(|(min, max)| (min.to_vec(), max.to_vec()))
    }

    fn cameras(&self) -> Vec<String> {
        self.core.flat().cameras.keys().cloned().collect()
    }

    fn start(&mut self) -> PyResult<()> {
        self.core.start().map_err(core_error)
    }

    fn poll(&mut self) -> PyResult<(f64, bool)> {
        self.core.poll().map_err(core_error)
    }

    fn wait(&mut self, py: Python<'_>, seconds: f64) -> PyResult<bool> {
        let end = Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 3600.0));
        loop {
            let (_, finished) = self.core.poll().map_err(core_error)?;
            if finished || Instant::now() >= end {
                return Ok(finished);
            }
            py.detach(|| std::thread::sleep(Duration::from_millis(5)));
            py.check_signals()?;
        }
    }

    fn stop(&mut self) {
        self.core.stop();
    }

    fn snapshot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (width, height, planes) = self.core.snapshot();
        let aovs = PyDict::new(py);
        for plane in planes {
            let flat = numpy::PyArray1::from_vec(py, plane.values);
            let shape = [height as usize, width as usize, plane.channels];
            let image: Bound<'py, PyArray3<f32>> = flat.reshape(shape)?;
            aovs.set_item(plane.name, image)?;
        }
        Ok(aovs)
    }

    fn stats(&self) -> String {
        self.core.stats().to_string()
    }

    fn write_exr(&self, file: PathBuf, attributes: &str) -> PyResult<()> {
        let attributes = serde_json::from_str(attributes).map_err(|e| json_error("attributes", e))?;
        self.core.write_exr(Path::new(&file), attributes).map_err(core_error)
    }
}

/// A numpy array as the core's, copied once.
fn any_array(array: &Bound<'_, PyAny>) -> PyResult<AnyArray> {
    fn flatten<T: numpy::Element + Copy>(array: &PyReadonlyArrayDyn<'_, T>) -> PyResult<(Vec<T>, usize)> {
        let components = array.as_array().shape().iter().skip(1).product();
        Ok((array.as_slice().map_err(|e| PyTypeError::new_err(format!("array: {e}")))?.to_vec(), components))
    }
    if let Ok(values) = array.extract::<PyReadonlyArrayDyn<'_, f32>>() {
        let (values, components) = flatten(&values)?;
        return Ok(AnyArray::F32(values, components));
    }
    if let Ok(values) = array.extract::<PyReadonlyArrayDyn<'_, i32>>() {
        let (values, components) = flatten(&values)?;
        return Ok(AnyArray::I32(values, components));
    }
    if let Ok(values) = array.extract::<PyReadonlyArrayDyn<'_, f64>>() {
        let (values, components) = flatten(&values)?;
        return Ok(AnyArray::F64(values, components));
    }
    if let Ok(values) = array.extract::<PyReadonlyArrayDyn<'_, u8>>() {
        let (values, components) = flatten(&values)?;
        return Ok(AnyArray::U8(values, components));
    }
    if let Ok(values) = array.extract::<PyReadonlyArrayDyn<'_, u16>>() {
        let (values, components) = flatten(&values)?;
        return Ok(AnyArray::U16(values, components));
    }
    Err(PyTypeError::new_err("arrays must be numpy arrays of float32, int32, float64, uint8 or uint16"))
}

/// The single-scattering albedo that shows `color` behind a boundary; see [`dermis::subsurface::inversion`].
#[pyfunction]
fn single_scattering_albedo(color: [f32; 3], anisotropy: f32, eta: f32, dielectric: bool) -> [f32; 3] {
    let illumination = if dielectric { Illumination::Normal } else { Illumination::Diffuse };
    inversion::single_scattering_albedo(color.into(), anisotropy, eta, illumination).into()
}

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("CoreError", m.py().get_type::<CoreError>())?;
    m.add_function(wrap_pyfunction!(single_scattering_albedo, m)?)?;
    m.add_class::<Delegate>()
}
