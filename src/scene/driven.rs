//! Materials with inputs that are driven: their surface is compiled anew at every point, from the numbers there.

use super::attribute::Values;
use super::image::ImageCache;
use super::network::{Lookup, Program};
use super::{Coating, Geometry, Instance};
use crate::bsdf::{NotedCurves, OfMesh, Surface};
use crate::error::Warning;
use crate::flat::{ChiangHair, Material, Network, OpenPbrSurface, PreviewSurface, StandardSurface};
use glam::{Vec2, Vec3, Vec4};
use std::borrow::Cow;

/// A material, and what drives some of its inputs.
pub struct Driven {
    /// Constants of the others; cloning it allocates nothing.
    material: Material,
    program: Program,
    setters: Vec<(Set, usize)>,
    /// Step that gives the normal in tangent space, and the primvar with its tangents.
    normal: Option<(usize, String)>,
    mesh: OfMesh,
    noted: NotedCurves,
}

/// Writes one input.
type Set = fn(&mut Material, Vec4);

/// An input's type from the four lanes of a node.
trait FromLanes {
    fn from_lanes(lanes: Vec4) -> Self;
}

impl FromLanes for f32 {
    fn from_lanes(lanes: Vec4) -> Self {
        lanes.x
    }
}

impl FromLanes for [f32; 2] {
    fn from_lanes(lanes: Vec4) -> Self {
        [lanes.x, lanes.y]
    }
}

impl FromLanes for [f32; 3] {
    fn from_lanes(lanes: Vec4) -> Self {
        lanes.truncate().to_array()
    }
}

impl FromLanes for Option<[f32; 3]> {
    fn from_lanes(lanes: Vec4) -> Self {
        Some(FromLanes::from_lanes(lanes))
    }
}

/// The setter of each input that can be driven, under its authored name.
macro_rules! setters {
    ($variant:ident, $name:ident; $($input:literal $field:ident),* $(,)?) => {
        match $name {
            $($input => |material, lanes| {
                if let Material::$variant(m) = material {
                    m.$field = FromLanes::from_lanes(lanes);
                }
            },)*
            _ => return None,
        }
    };
}

fn setter(material: &Material, name: &str) -> Option<Set> {
    Some(match material {
        Material::UsdPreviewSurface(_) => setters!(UsdPreviewSurface, name;
            "diffuseColor" diffuse_color, "emissiveColor" emissive_color, "specularColor" specular_color,
            "metallic" metallic, "roughness" roughness, "clearcoat" clearcoat,
            "clearcoatRoughness" clearcoat_roughness, "opacity" opacity, "opacityThreshold" opacity_threshold,
            "ior" ior, "subsurface" subsurface, "subsurfaceColor" subsurface_color,
            "subsurfaceRadius" subsurface_radius, "subsurfaceScale" subsurface_scale,
            "subsurfaceAnisotropy" subsurface_anisotropy, "subsurfaceAlbedo" subsurface_albedo),
        Material::OpenPbr(_) => setters!(OpenPbr, name;
            "base_weight" base_weight, "base_color" base_color, "base_diffuse_roughness" base_diffuse_roughness,
            "base_metalness" base_metalness, "specular_weight" specular_weight, "specular_color" specular_color,
            "specular_roughness" specular_roughness, "specular_ior" specular_ior,
            "transmission_weight" transmission_weight, "transmission_color" transmission_color,
            "transmission_depth" transmission_depth, "transmission_scatter" transmission_scatter,
            "transmission_scatter_anisotropy" transmission_scatter_anisotropy,
            "subsurface_weight" subsurface_weight, "subsurface_color" subsurface_color,
            "subsurface_radius" subsurface_radius, "subsurface_radius_scale" subsurface_radius_scale,
            "subsurface_scatter_anisotropy" subsurface_scatter_anisotropy, "coat_weight" coat_weight,
            "coat_color" coat_color, "coat_roughness" coat_roughness, "coat_ior" coat_ior,
            "emission_luminance" emission_luminance, "emission_color" emission_color,
            "geometry_opacity" geometry_opacity),
        Material::StandardSurface(_) => setters!(StandardSurface, name;
            "base" base, "base_color" base_color, "diffuse_roughness" diffuse_roughness, "metalness" metalness,
            "specular" specular, "specular_color" specular_color, "specular_roughness" specular_roughness,
            "specular_IOR" specular_ior, "transmission" transmission, "transmission_color" transmission_color,
            "transmission_depth" transmission_depth, "transmission_scatter" transmission_scatter,
            "transmission_scatter_anisotropy" transmission_scatter_anisotropy, "subsurface" subsurface,
            "subsurface_color" subsurface_color, "subsurface_radius" subsurface_radius,
            "subsurface_scale" subsurface_scale, "subsurface_anisotropy" subsurface_anisotropy, "coat" coat,
            "coat_color" coat_color, "coat_roughness" coat_roughness, "coat_IOR" coat_ior, "emission" emission,
            "emission_color" emission_color, "opacity" opacity),
        Material::Hair(_) => setters!(Hair, name;
            "tint_R" tint_r, "tint_TT" tint_tt, "tint_TRT" tint_trt, "ior" ior, "roughness_R" roughness_r,
            "roughness_TT" roughness_tt, "roughness_TRT" roughness_trt, "cuticle_angle" cuticle_angle,
            "absorption_coefficient" absorption_coefficient, "opacity" opacity),
    })
}

/// Weights that decide whether there is a medium, with the least that the stand-in of the whole material has: a
/// pyramid's mean may round to 0 where some points have one.
const MEDIUM_WEIGHTS: [&str; 4] = ["subsurface", "subsurface_weight", "transmission", "transmission_weight"];
const LEAST_WEIGHT: f32 = 0.01;

/// Opacity inputs: shadow rays ask for them.
const OPACITIES: [&str; 4] = ["opacity", "opacityThreshold", "geometry_opacity", "metallic"];

/// Inputs that decide how a guided walk turns.
const ANISOTROPIES: [&str; 4] = [
    "subsurfaceAnisotropy",
    "subsurface_scatter_anisotropy",
    "subsurface_anisotropy",
    "transmission_scatter_anisotropy",
];

/// Inputs that change what a medium is made of (the index by way of the colour's inversion).
const MEDIA: [&str; 18] = [
    "subsurfaceColor",
    "subsurfaceRadius",
    "subsurfaceScale",
    "subsurfaceAlbedo",
    "subsurface_color",
    "subsurface_radius",
    "subsurface_radius_scale",
    "subsurface_scale",
    "transmission",
    "transmission_weight",
    "transmission_color",
    "transmission_depth",
    "transmission_scatter",
    "ior",
    "specular_ior",
    "specular_IOR",
    "specular_weight",
    "specular",
];

impl Driven {
    /// The driven material, and the surface that stands for all of it where no point is at hand: that of the means
    /// of its images, at the middle of the first triangle; there is one.
    pub fn compile(
        material: &Material,
        geometry: &Geometry,
        mesh: OfMesh,
        images: &ImageCache,
        prim: &str,
        warnings: &mut Vec<Warning>,
    ) -> (Self, Surface) {
        let network = material.network();
        let program = Program::compile(network, images);
        let tangents = if network.tangents.is_empty() { "st" } else { &network.tangents };
        let mut setters = Vec::new();
        let mut normal = None;
        for (name, step) in &program.inputs {
            match setter(material, name) {
                Some(set) => setters.push((set, *step)),
                None if name == "normal" => normal = Some((*step, tangents.to_owned())),
                None => warnings.push(Warning::new(prim, format!("inputs:{name} cannot be driven; ignored"))),
            }
        }
        let mut typical = interned(material);
        let lookup = Lookup {
            primvars: &geometry.primvars,
            instance: None,
            triangle: 0,
            corners: geometry.triangles[0],
            at: Vec2::splat(1.0 / 3.0),
            across: None,
            time: 0.0,
        };
        let normal = normal.filter(|(_, primvar)| {
            let there = geometry.primvars.contains_key(primvar);
            if !there {
                let message = format!("inputs:normal: the mesh has no primvars:{primvar} for its tangents; ignored");
                warnings.push(Warning::new(prim, message));
            }
            there
        });
        program.run(&lookup, |value| {
            for (name, step) in &program.inputs {
                let Some(set) = setter(material, name) else { continue };
                let least = if MEDIUM_WEIGHTS.contains(&name.as_str()) { LEAST_WEIGHT } else { f32::NEG_INFINITY };
                set(&mut typical, value(*step).max(Vec4::splat(least)));
            }
        });
        let (surface, noted) = Surface::compile_noting(&typical, mesh, prim, warnings);
        (Self { material: interned(material), program, setters, normal, mesh, noted }, surface)
    }

    /// Whether shadow rays have to ask at every point.
    pub fn opacity(&self) -> bool {
        self.drives(&OPACITIES)
    }

    /// Whether the shape of the phase function differs from point to point.
    pub fn anisotropy(&self) -> bool {
        self.drives(&ANISOTROPIES)
    }

    /// Whether the medium differs from point to point.
    pub fn medium(&self) -> bool {
        self.drives(&MEDIA) || self.anisotropy()
    }

    fn drives(&self, names: &[&str]) -> bool {
        self.program.inputs.iter().any(|(name, _)| names.contains(&name.as_str()))
    }

    /// Whether normals are bent.
    pub fn bends(&self) -> bool {
        self.normal.is_some()
    }

    /// The coating at a point of `instance`, and the normal there where it is bent. `front`: the shading normal on the
    /// front side; both in render space, unit.
    pub(super) fn at(
        &self,
        instance: &Instance,
        lookup: &Lookup,
        display_color: Option<Vec3>,
        front: Vec3,
    ) -> (Coating, Option<Vec3>) {
        let mut material = self.material.clone();
        let tangent = self.program.run(lookup, |value| {
            self.setters.iter().for_each(|(set, step)| set(&mut material, value(*step)));
            self.normal.as_ref().map(|(step, primvar)| (value(*step).truncate(), primvar))
        });
        let mesh = OfMesh { display_color: display_color.or(self.mesh.display_color), ..self.mesh };
        let surface = Surface::at_point(&material, mesh, &self.noted);
        let interior = surface.interior().map(|interior| super::coats::compile_interior(&interior));
        let normal = tangent.and_then(|(n, primvar)| bend(n, lookup.primvars.get(primvar)?, instance, lookup, front));
        (Coating { surface, interior, driven: None }, normal)
    }
}

/// `n` of tangent space in render space: x along the directions of s, made orthogonal to the shading normal, y to
/// the side where t grows, which tells mirrored coordinates. `None` where nothing is bent.
fn bend(n: Vec3, st: &Values, instance: &Instance, lookup: &Lookup, front: Vec3) -> Option<Vec3> {
    if !n.is_finite() || (n.x == 0.0 && n.y == 0.0) {
        return None;
    }
    let [a, b, c] = instance.geometry.corners(lookup.triangle as u32, lookup.time);
    let placed = instance.placed(lookup.time);
    let [e1, e2] = [b - a, c - a].map(|edge| placed.vector(edge));
    let at = |u, v| st.at(lookup.triangle, lookup.corners, u, v).truncate().truncate();
    let origin = at(0.0, 0.0);
    let (d1, d2) = (at(1.0, 0.0) - origin, at(0.0, 1.0) - origin);
    let determinant = d1.perp_dot(d2);
    // The sign is all that is asked of the determinant: a division would overflow where coordinates hardly move.
    let (along_s, along_t) = (e1 * d2.y - e2 * d1.y, e2 * d1.x - e1 * d2.x);
    let turn = if determinant < 0.0 { -1.0 } else { 1.0 };
    let tangent = ((along_s - front * along_s.dot(front)) * turn).try_normalize()?;
    let side = front.cross(tangent);
    let bitangent = if side.dot(along_t) * turn < 0.0 { -side } else { side };
    (determinant != 0.0).then(|| (tangent * n.x + bitangent * n.y + front * n.z).normalize_or(front))
}

/// Without its network, its tokens borrowed.
fn interned(material: &Material) -> Material {
    let token = |name: &str, known: &[&'static str]| {
        let found = known.iter().copied().find(|token| *token == name);
        found.map_or_else(|| Cow::Owned(name.to_owned()), Cow::Borrowed)
    };
    match material {
        Material::UsdPreviewSurface(m) => Material::UsdPreviewSurface(PreviewSurface {
            opacity_mode: token(&m.opacity_mode, &["transparent", "presence"]),
            subsurface_boundary: token(&m.subsurface_boundary, &["diffuse", "dielectric", "indexMatched"]),
            network: Network::default(),
            displacement: Network::default(),
            ..m.clone()
        }),
        Material::OpenPbr(m) => Material::OpenPbr(OpenPbrSurface {
            network: Network::default(),
            displacement: Network::default(),
            ..m.clone()
        }),
        Material::StandardSurface(m) => Material::StandardSurface(StandardSurface {
            network: Network::default(),
            displacement: Network::default(),
            ..m.clone()
        }),
        Material::Hair(m) => {
            Material::Hair(ChiangHair { network: Network::default(), displacement: Network::default(), ..m.clone() })
        }
    }
}
