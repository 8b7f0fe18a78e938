"""The surface shaders dermis knows: their inputs with the defaults of their specifications."""

from dataclasses import dataclass
from typing import Any

Inputs = dict[str, Any]

ANY = object()
"""Default of an ignored input that has an effect whenever it is authored."""


@dataclass(frozen=True)
class Shader:
    """`inputs`: rendered. `ignored`: not rendered, said when it differs from its default. `idle`: companions
    of an ignored input, without effect of their own. `normal`: the input that bends normals, in `tangent_space` or by
    way of a MaterialX `normalmap`."""

    name: str
    inputs: Inputs
    ignored: Inputs
    idle: frozenset[str] = frozenset()
    normal: str = "normal"
    tangent_space: bool = False


BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
GREY = (0.8, 0.8, 0.8)

PREVIEW_SURFACE = Shader(
    "UsdPreviewSurface",
    {
        "diffuseColor": (0.18, 0.18, 0.18),
        "emissiveColor": BLACK,
        "useSpecularWorkflow": 0,
        "specularColor": BLACK,
        "metallic": 0.0,
        "roughness": 0.5,
        "clearcoat": 0.0,
        "clearcoatRoughness": 0.01,
        "opacity": 1.0,
        "opacityMode": "transparent",
        "opacityThreshold": 0.0,
        "ior": 1.5,
        "subsurface": 0.0,
        "subsurfaceColor": GREY,
        "subsurfaceRadius": WHITE,
        "subsurfaceScale": 1.0,
        "subsurfaceAnisotropy": 0.0,
        "subsurfaceBoundary": "diffuse",
        "subsurfaceAlbedo": WHITE,
        "subsurfacePriority": 0,
    },
    {},
    # Occlusion is for rasterisers: a path tracer computes it. Displacement is what outputs:displacement leads to.
    frozenset({"occlusion", "displacement"}),
    tangent_space=True,
)

OPEN_PBR = Shader(
    "ND_open_pbr_surface_surfaceshader",
    {
        "base_weight": 1.0,
        "base_color": GREY,
        "base_diffuse_roughness": 0.0,
        "base_metalness": 0.0,
        "specular_weight": 1.0,
        "specular_color": WHITE,
        "specular_roughness": 0.3,
        "specular_ior": 1.5,
        "transmission_weight": 0.0,
        "transmission_color": WHITE,
        "transmission_depth": 0.0,
        "transmission_scatter": BLACK,
        "transmission_scatter_anisotropy": 0.0,
        "subsurface_weight": 0.0,
        "subsurface_color": GREY,
        "subsurface_radius": 1.0,
        "subsurface_radius_scale": (1.0, 0.5, 0.25),
        "subsurface_scatter_anisotropy": 0.0,
        "coat_weight": 0.0,
        "coat_color": WHITE,
        "coat_roughness": 0.0,
        "coat_ior": 1.6,
        "emission_luminance": 0.0,
        "emission_color": WHITE,
        "geometry_opacity": 1.0,
    },
    {
        "specular_roughness_anisotropy": 0.0,
        "transmission_dispersion_scale": 0.0,
        "coat_roughness_anisotropy": 0.0,
        "coat_darkening": 1.0,
        "fuzz_weight": 0.0,
        "thin_film_weight": 0.0,
        "geometry_thin_walled": False,
        "geometry_coat_normal": ANY,
    },
    frozenset(
        {
            "transmission_dispersion_abbe_number",
            "fuzz_color",
            "fuzz_roughness",
            "thin_film_thickness",
            "thin_film_ior",
            "geometry_tangent",
            "geometry_coat_tangent",
        }
    ),
    normal="geometry_normal",
)

STANDARD_SURFACE = Shader(
    "ND_standard_surface_surfaceshader",
    {
        "base": 1.0,
        "base_color": GREY,
        "diffuse_roughness": 0.0,
        "metalness": 0.0,
        "specular": 1.0,
        "specular_color": WHITE,
        "specular_roughness": 0.2,
        "specular_IOR": 1.5,
        "transmission": 0.0,
        "transmission_color": WHITE,
        "transmission_depth": 0.0,
        "transmission_scatter": BLACK,
        "transmission_scatter_anisotropy": 0.0,
        "subsurface": 0.0,
        "subsurface_color": WHITE,
        "subsurface_radius": WHITE,
        "subsurface_scale": 1.0,
        "subsurface_anisotropy": 0.0,
        "coat": 0.0,
        "coat_color": WHITE,
        "coat_roughness": 0.1,
        "coat_IOR": 1.5,
        "emission": 0.0,
        "emission_color": WHITE,
        "opacity": WHITE,
    },
    {
        "specular_anisotropy": 0.0,
        "transmission_dispersion": 0.0,
        "transmission_extra_roughness": 0.0,
        "sheen": 0.0,
        "coat_anisotropy": 0.0,
        "coat_affect_color": 0.0,
        "coat_affect_roughness": 0.0,
        "thin_film_thickness": 0.0,
        "thin_walled": False,
        "coat_normal": ANY,
    },
    frozenset(
        {"specular_rotation", "sheen_color", "sheen_roughness", "coat_rotation", "thin_film_IOR", "tangent"}
    ),
)

HAIR = Shader(
    "ND_chiang_hair_bsdf",
    {
        "tint_R": WHITE,
        "tint_TT": WHITE,
        "tint_TRT": WHITE,
        "ior": 1.55,
        "roughness_R": (0.1, 0.1),
        "roughness_TT": (0.05, 0.05),
        "roughness_TRT": (0.2, 0.2),
        "cuticle_angle": 0.5,
        "absorption_coefficient": BLACK,
    },
    {"curve_direction": ANY},
)
"""A BSDF; the surface shader is the `ND_surface` before it."""

SURFACE = Shader("ND_surface", {"opacity": 1.0}, {"edf": ANY, "thin_walled": False}, frozenset({"bsdf"}))
"""MaterialX `surface`, rendered where its BSDF is hair."""

SHADERS = {
    "UsdPreviewSurface": PREVIEW_SURFACE,
    "ND_UsdPreviewSurface_surfaceshader": PREVIEW_SURFACE,
    "ND_open_pbr_surface_surfaceshader": OPEN_PBR,
    "ND_standard_surface_surfaceshader": STANDARD_SURFACE,
}
"""By `info:id`."""
