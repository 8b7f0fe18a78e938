"""AOVs beside the beauty, as `flat::RenderSettings::aovs` names them: AOVS by default, the others where asked for."""

AOVS = (
    "alpha",
    "depth",
    "normal",
    "position",
    "albedo",
    "primId",
    "direct",
    "indirect",
    "subsurface",
    "variance",
)

GUIDE_AOVS = ("slabNormal", "entryAgreement", "walkLength", "region", "cacheIrradiance", "techniqueShares")

PRIMVAR = "primvars:"
"""Before the name of a primvar of the first surface."""

EXTRA_AOVS = (
    "distance",
    "deviceDepth",
    "Peye",
    "Neye",
    "motionVector",
    "emission",
    "firstBounce",
    "sampleCount",
    "cryptoObject",
)

LIGHT_AOV = "light_"
"""What AOVs of a light group, or of one light, are named, before its name; only where asked for."""
