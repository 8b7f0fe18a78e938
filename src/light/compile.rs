//! From UsdLux attributes to lights; what cannot shine is dropped aloud.

use super::{
    Light, Lights, area::AreaLight, bound::Bound, cylinder::Cylinder, disk::Disk, distant, distant::Distant,
    dome::Dome, ellipsoid::Ellipsoid, emission::Emission, mesh::TriangleSet, motion::Motion, portal::Portals,
    rect::Rect, shape::Shape, texels::Texels, tree::Tree,
};
use crate::{
    error::Warning,
    flat::{self, LightShape, Prims},
    math::Affine,
};
use glam::{DVec3, Vec3};

/// Triangles of the mesh with the given key, in render space, wound so that (b - a) x (c - a) points outward.
pub type MeshTriangles<'a> = dyn Fn(&str) -> Option<Vec<[Vec3; 3]>> + 'a;

/// Areas, in stage units^2, whose reciprocal leaves the range of f32.
const SMALLEST_AREA: f64 = 1e-30;
const LARGEST_AREA: f64 = 1e30;

impl Lights {
    /// Compiles the visible lights. Render space is world translated by `-origin`. Lights that cannot emit
    /// because of their attributes are left out with a warning, lights that are black without one.
    pub fn compile(
        lights: &Prims<flat::Light>,
        textures: &Prims<flat::Texture>,
        mesh_triangles: &MeshTriangles,
        origin: DVec3,
        moves: bool,
        warnings: &mut Vec<Warning>,
    ) -> Lights {
        let mut compiled = Lights::default();
        for (path, prim) in lights.iter().filter(|(_, light)| light.visible) {
            let mut compiler = Compiler { textures, mesh_triangles, origin, path, warnings };
            match compiler.light(prim) {
                Ok(light) if light.shines() => {
                    let motion = if moves { compiler.motion(prim) } else { None };
                    compiled.push(path, prim, light, motion);
                }
                Ok(_) => {}
                Err(message) => compiler.warn(format!("{message}: light dropped")),
            }
        }
        compiled.plant();
        if compiled.responses.iter().all(|response| *response == [1.0; 2]) {
            compiled.responses.clear();
        }
        compiled
    }

    /// Sorts the lights into the tree and those beside it.
    fn plant(&mut self) {
        let bound = |(i, light): (usize, &Light)| match light {
            Light::Area(area) => {
                let motion = self.motions.get(i).and_then(Option::as_ref);
                Some((i as u32, motion.map_or_else(|| area.bound(), |motion| motion.bound(area.bound()))))
            }
            Light::Distant(_) | Light::Dome(_) => None,
        };
        let bounds: Vec<(u32, Bound)> = self.lights.iter().enumerate().filter_map(bound).collect();
        self.tree = Tree::build(&bounds, self.lights.len());
        let beside = |light: &u32| self.tree.as_ref().is_none_or(|tree| !tree.contains(*light));
        self.beside = (0..self.lights.len() as u32).filter(beside).collect();
    }

    fn push(&mut self, path: &str, prim: &flat::Light, light: Light, motion: Option<Motion>) {
        let index = self.lights.len() as u32;
        if motion.is_some() || self.is_moving() {
            self.motions.resize_with(self.lights.len(), || None);
            self.motions.push(motion);
        }
        match (&light, &prim.shape) {
            (Light::Dome(_), _) => self.infinite.push(index),
            (Light::Distant(distant), _) if distant.is_delta() => self.single.push(index),
            (Light::Distant(_), _) => self.infinite.push(index),
            (_, LightShape::Mesh { mesh }) => _ = self.meshes.insert(mesh.clone(), index),
            _ => {}
        }
        self.paths.push(path.to_owned());
        self.camera_visible.push(prim.camera_visible);
        self.responses.push([prim.diffuse, prim.specular]);
        self.lights.push(light);
    }
}

struct Compiler<'a> {
    textures: &'a Prims<flat::Texture>,
    mesh_triangles: &'a MeshTriangles<'a>,
    origin: DVec3,
    path: &'a str,
    warnings: &'a mut Vec<Warning>,
}

impl Compiler<'_> {
    fn warn(&mut self, message: String) {
        self.warnings.push(Warning::new(self.path, message));
    }

    /// `None`: it stays.
    fn motion(&mut self, prim: &flat::Light) -> Option<Motion> {
        let keys = prim.transform_keys.as_ref()?;
        let place = |matrix: &flat::Matrix4d| Affine::from_usd(matrix, DVec3::ZERO, self.origin);
        let places: Vec<Affine> = keys.transforms.iter().map(|matrices| place(&matrices[0])).collect::<Option<_>>()?;
        let motion = Motion::new(&keys.times, &places, &place(&prim.transform)?)?;
        if motion.is_stretched() {
            let message =
                "xformOps: its size changes while the shutter is open; it moves and turns with that of the frame";
            self.warn(message.into());
        }
        Some(motion)
    }

    /// `Err` names the attribute at fault.
    fn light(&mut self, prim: &flat::Light) -> Result<Light, String> {
        let placement = Affine::from_usd(&prim.transform, DVec3::ZERO, self.origin)
            .ok_or("xformOps give a transform that is singular or out of range")?;
        let axis = placement.vector(Vec3::NEG_Z).as_dvec3().normalize().as_vec3();
        match &prim.shape {
            LightShape::Distant { angle } => {
                if !(angle.is_finite() && *angle >= 0.0) {
                    return Err(format!("inputs:angle is {angle}, not a positive number or zero"));
                }
                let emission =
                    Emission::new(prim, axis, distant::size_factor(*angle))?.profiled(prim, placement.inverse)?;
                Ok(Light::Distant(Distant::new(emission, *angle)))
            }
            LightShape::Dome { texture, pole_axis } => {
                // normalize does not apply to domes (UsdLuxLightAPI).
                let emission = Emission::new(prim, axis, 1.0)?.without_shaping();
                if prim.shaping.is_some() {
                    self.warn("inputs:shaping has no meaning on a dome: ignored".into());
                }
                let texels = self.texels(texture, true);
                let portals = Portals::new(prim.portals.iter().filter_map(|portal| self.portal(portal)).collect());
                Ok(Light::Dome(Dome::new(&emission, texels, &placement, pole_axis).guided(portals)))
            }
            shape => {
                let texels = match shape {
                    LightShape::Rect { texture, .. } => self.texels(texture, false),
                    _ => None,
                };
                let shape = self.shape(shape, &placement)?;
                let area = shape.area();
                if !(SMALLEST_AREA..LARGEST_AREA).contains(&area) {
                    return Err(format!("its size and xformOps give an area of {area:e} square stage units"));
                }
                Ok(Light::Area(AreaLight::new(
                    shape,
                    Emission::new(prim, axis, area)?.profiled(prim, placement.inverse)?,
                    texels,
                )))
            }
        }
    }

    fn shape(&self, shape: &LightShape, placement: &Affine) -> Result<Shape, String> {
        let built = match *shape {
            LightShape::Rect { width, height, .. } => {
                let (width, height) = (positive("inputs:width", width)?, positive("inputs:height", height)?);
                Rect::new(placement, width, height).map(Shape::Rect)
            }
            LightShape::Disk { radius } => Disk::new(placement, positive("inputs:radius", radius)?).map(Shape::Disk),
            LightShape::Sphere { radius } => {
                Ellipsoid::new(placement, positive("inputs:radius", radius)?).map(Shape::Ellipsoid)
            }
            LightShape::Cylinder { length, radius } => {
                let (length, radius) = (positive("inputs:length", length)?, positive("inputs:radius", radius)?);
                Cylinder::new(placement, length, radius).map(Shape::Cylinder)
            }
            LightShape::Mesh { ref mesh } => {
                let triangles = (self.mesh_triangles)(mesh).ok_or(format!("its mesh {mesh} is not in the scene"))?;
                TriangleSet::new(triangles).map(Shape::Mesh)
            }
            LightShape::Distant { .. } | LightShape::Dome { .. } => None,
        };
        built.ok_or_else(|| "its size and xformOps give a shape without area or out of range".into())
    }

    /// Of a dome, which shines without those that cannot be placed.
    fn portal(&mut self, portal: &flat::Portal) -> Option<Rect> {
        let placement = Affine::from_usd(&portal.transform, DVec3::ZERO, self.origin);
        let rect = placement.and_then(|placement| Rect::new(&placement, portal.width, portal.height));
        let sound = rect.filter(|rect| (SMALLEST_AREA..LARGEST_AREA).contains(&rect.area()));
        if sound.is_none() {
            let message = "its size and xformOps give no area or one out of range: it guides nothing";
            self.warnings.push(Warning::new(&portal.path, message));
        }
        sound
    }

    /// The image of that key; without one, or without a usable one, the light is untextured.
    fn texels(&mut self, key: &str, wrap: bool) -> Option<Texels> {
        if key.is_empty() {
            return None;
        }
        let Some(texture) = self.textures.get(key) else {
            self.warn(format!("inputs:texture:file {key} is not in the scene: rendered without it"));
            return None;
        };
        Texels::new(texture, wrap, &mut |message| self.warn(format!("inputs:texture:file {key} {message}")))
    }
}

fn positive(name: &str, value: f32) -> Result<f32, String> {
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err(format!("{name} is {value}, not a positive number")) }
}
