"""What the flattened scene means, in numbers that any renderer understands: the view, media, surfaces, light.

Written from the specifications of UsdGeomCamera, UsdLux and UsdPreviewSurface and from the definition of dermis'
subsurface inputs, not from dermis' core, so that a peer is a second opinion; only the inversion of colours is the
core's. What a peer cannot be told raises ExportError: a comparison of two different scenes would be worth nothing.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..stage import FlatStage

Fields = dict[str, Any]
Matrix = NDArray[np.float64]
"""4 x 4, for column vectors: the transpose of USD's."""

Rgb = tuple[float, float, float]

#: Roughness that dermis' microfacets cannot tell from smooth (its floor, alpha 1e-6).
SMOOTH = 1e-3


class ExportError(Exception):
    """A scene that has no equivalent in a peer; the text names prim and attribute."""


def require(holds: bool, path: str, name: str, value: Any) -> None:
    if not holds:
        raise ExportError(f"{path}: {name} {value} is not exported to other renderers")


def matrix(prim: Fields) -> Matrix:
    return np.array(prim["transform"], dtype=np.float64).reshape(4, 4).T


# The view.


@dataclass(frozen=True)
class View:
    """A pinhole camera."""

    #: Camera to world without scale; looks along -Z, up +Y.
    to_world: Matrix
    #: Half of the image's width at unit distance; pixels are square.
    tangent: float
    clipping: tuple[float, float]
    resolution: tuple[int, int]
    #: Scale of the image.
    exposure: float

    @property
    def fov_x(self) -> float:
        """Degrees."""
        return math.degrees(2.0 * math.atan(self.tangent))

    def pixel(self, point: NDArray[np.float64]) -> tuple[float, float]:
        """Where a world point is seen, in pixels from the upper left corner."""
        x, y, z = (np.linalg.inv(self.to_world) @ [*point, 1.0])[:3]
        width, height = self.resolution
        scale = 0.5 * width / self.tangent
        return 0.5 * width + scale * x / -z, 0.5 * height - scale * y / -z


def view_of(flat: FlatStage) -> View:
    """The render camera with the film of the settings. Raises ExportError."""
    settings = flat.settings
    path = settings["camera"]
    camera, (width, height) = flat.prims[path], settings["resolution"]
    require(camera["projection"] == "perspective", path, "projection", camera["projection"])
    for name in ("horizontalApertureOffset", "verticalApertureOffset"):
        require(camera[name] == 0.0, path, name, camera[name])
    focused = settings.get("disableDepthOfField") or 0.0 in (camera["fStop"], camera["focusDistance"])
    require(bool(focused), path, "fStop", camera["fStop"])
    moving = [key for key, prim in flat.prims.items() if "transformKeys" in prim or "pointKeys" in prim]
    still = bool(settings.get("disableMotionBlur")) or not moving
    require(still, moving[0] if moving else path, "shutter:open, shutter:close", "motion blur")
    space = settings.get("renderingColorSpace", "")
    require(space in ("", "lin_rec709_scene"), path, "renderingColorSpace", space)
    policy = settings.get("aspectRatioConformPolicy", "expandAperture")
    require(policy == "expandAperture", path, "aspectRatioConformPolicy", policy)
    aspect = settings.get("pixelAspectRatio", 1.0)
    require(aspect == 1.0, path, "pixelAspectRatio", aspect)
    # expandAperture: the smaller of the two grows until the window has the image's aspect.
    aperture = max(camera["horizontalAperture"], camera["verticalAperture"] * width / height)
    near, far = camera["clippingRange"]
    return View(
        rigid(matrix(camera)),
        0.5 * aperture / camera["focalLength"],
        (near, far),
        (width, height),
        camera["exposureScale"],
    )


def rigid(columns: Matrix) -> Matrix:
    """Without the scale of its axes, which does not change what a camera sees (GfFrustum)."""
    axes = columns[:3, :3] / np.linalg.norm(columns[:3, :3], axis=0)
    result = columns.copy()
    result[:3, :3] = axes
    return result


# Surfaces and media.


@dataclass(frozen=True)
class Medium:
    """The interior of a mesh; boundary: `diffuse`, `dielectric`, `indexMatched`."""

    boundary: str
    ior: float
    roughness: float
    #: Mean free path per channel, stage units.
    radius: Rgb
    #: Multiple-scattering albedo, where that is what was asked for.
    color: Rgb | None
    #: Single-scattering albedo.
    albedo: Rgb
    #: Mean cosine of the Henyey-Greenstein phase function.
    g: float

    @property
    def smooth(self) -> bool:
        return self.roughness <= SMOOTH


#: Defaults of UsdPreviewSurface, and of dermis' subsurface inputs.
DEFAULTS: Fields = {
    "metallic": 0.0,
    "clearcoat": 0.0,
    "opacity": 1.0,
    "roughness": 0.5,
    "ior": 1.5,
    "useSpecularWorkflow": 0,
    "emissiveColor": (0.0, 0.0, 0.0),
    "subsurface": 0.0,
    "subsurfaceColor": (0.8, 0.8, 0.8),
    "subsurfaceRadius": (1.0, 1.0, 1.0),
    "subsurfaceScale": 1.0,
    "subsurfaceAnisotropy": 0.0,
    "subsurfaceBoundary": "diffuse",
}


def surface_of(flat: FlatStage, mesh: Fields) -> tuple[Fields, str]:
    """Inputs of the material of a mesh, and its path. Raises ExportError."""
    path = mesh["material"]
    authored = flat.prims[path] if path else {"shader": "UsdPreviewSurface"}
    require(authored["shader"] == "UsdPreviewSurface", path, "shader", authored["shader"])
    driven = ", ".join(authored.get("network", {}).get("inputs", ()))
    require(not driven, path, "a network that drives", driven)
    displaced = bool(authored.get("displacement", {}).get("inputs"))
    require(not displaced, path, "displacement", "a network")
    for name in ("subsurfaceSet", "mediumPriority"):
        require(not mesh.get(name), path, f"primvars:dermis:{name}", mesh.get(name))
    material = {**DEFAULTS, **{name: value for name, value in authored.items() if value is not None}}
    for name in ("metallic", "clearcoat"):
        require(material[name] == 0.0, path, name, material[name])
    require(material["opacity"] == 1.0, path, "opacity", material["opacity"])
    require(not any(material["emissiveColor"]), path, "emissiveColor", material["emissiveColor"])
    require(material["subsurface"] in (0.0, 1.0), path, "subsurface", material["subsurface"])
    return material, path


def diffuse_color(material: Fields, mesh: Fields, path: str) -> Rgb:
    """What an opaque surface reflects: authored, else the displayColor of the mesh, else 18 % grey."""
    if "diffuseColor" in material:
        return triple(material["diffuseColor"])
    shown = mesh.get("displayColor")
    if not shown:
        return (0.18, 0.18, 0.18)
    require(
        shown["interpolation"] == "constant", path, "displayColor with interpolation", shown["interpolation"]
    )
    return triple(shown["values"][0])


def medium_of(material: Fields, boundary: str) -> Medium | None:
    """The medium of a material; None for an opaque one. `boundary`: the setting `subsurfaceBoundary`."""
    if material["subsurface"] == 0.0:
        return None
    kind = material["subsurfaceBoundary"] if boundary in ("", "auto") else boundary
    if kind == "dielectric" and material["ior"] == 1.0:
        kind = "indexMatched"
    radius = np.array(material["subsurfaceRadius"], dtype=float) * material["subsurfaceScale"]
    g = material["subsurfaceAnisotropy"]
    single = material.get("subsurfaceAlbedo")
    color = None if single is not None else triple(material["subsurfaceColor"])
    return Medium(
        kind,
        material["ior"],
        material["roughness"],
        # The core's floor: what is shorter looks opaque in any case.
        triple(np.maximum(radius, 1e-4 * radius.max())),
        color,
        triple(single) if color is None else inverted(color, g, material["ior"], kind),
        g,
    )


def inverted(color: Rgb, g: float, ior: float, boundary: str) -> Rgb:
    from .._core import single_scattering_albedo

    dielectric = boundary == "dielectric"
    return triple(single_scattering_albedo(color, g, ior if dielectric else 1.0, dielectric))


def triple(values: Any) -> Rgb:
    r, g, b = (float(value) for value in values)
    return (r, g, b)


# Light.


def radiance(prim: Fields, size: float) -> Rgb:
    """intensity 2^exposure color, over the `size` factor of its shape if normalised (UsdLuxLightAPI)."""
    scale = prim["intensity"] * 2.0 ** prim["exposure"] / (size if prim["normalize"] else 1.0)
    tint = prim["blackbody"] if prim["enableColorTemperature"] else (1.0, 1.0, 1.0)
    return triple(scale * np.array(prim["color"]) * np.array(tint))


def lights_of(flat: FlatStage) -> dict[str, Fields]:
    """Lights that shine, by path."""
    found = {path: prim for path, prim in flat.prims.items() if prim["type"] == "Light" and prim["visible"]}
    for path, prim in found.items():
        for name in ("lightLink", "shadowLink", "shadow"):
            require(not prim.get(name), path, name, "a collection or a rule")
        for name in ("diffuse", "specular"):
            require(prim.get(name, 1.0) == 1.0, path, f"inputs:{name}", "a factor")
        require(not (prim.get("shaping") or {}).get("ies"), path, "shaping:ies:file", "a profile")
        require(
            not prim["shape"].get("texture") or prim["shape"]["kind"] == "dome", path, "texture on a", "light"
        )
    return found


def lights_seen(lights: dict[str, Fields]) -> bool:
    """Whether the camera sees lights: all or none, since peers cannot tell them apart. Raises ExportError."""
    seen = {prim["cameraVisible"] for prim in lights.values()}
    if len(seen) > 1:
        raise ExportError("visibility:camera: of several lights some are seen: that is not exported")
    return True in seen


def distant_irradiance(prim: Fields) -> Rgb:
    """Of a surface that faces a DistantLight."""
    half = math.radians(0.5 * prim["shape"]["angle"])
    factor = 1.0 if half == 0.0 else math.pi * math.sin(half) ** 2
    return triple(factor * np.array(radiance(prim, factor)))


def dome_turn(prim: Fields) -> Matrix:
    """Map to world: in the map's frame the pole is +Y, and the middle of the image +Z, with +X to its left."""
    turn = np.eye(4)
    if prim["shape"]["poleAxis"] == "Z":
        # +Y to +Z, +Z to -Y.
        turn[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    return matrix(prim) @ turn


def spanned(columns: Matrix) -> float:
    """Area of the parallelogram of the images of X and Y."""
    return float(np.linalg.norm(np.cross(columns[:3, 0], columns[:3, 1])))


def uniform_scale(columns: Matrix, path: str) -> float:
    """Raises ExportError for an ellipsoid."""
    scales = np.linalg.norm(columns[:3, :3], axis=0)
    # 1e-6: rounding of a rotation, as authored in single precision.
    require(bool(np.ptp(scales) <= 1e-6 * scales.max()), path, "a sphere scaled by", scales)
    return float(scales[0])
