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
    "directDiffuse",
    "indirectDiffuse",
    "directSpecular",
    "indirectSpecular",
    "directTransmission",
    "indirectTransmission",
    "diffuse",
    "specular",
    "transmission",
)

CELLS = (
    "emission",
    "directDiffuse",
    "indirectDiffuse",
    "directSpecular",
    "indirectSpecular",
    "directTransmission",
    "indirectTransmission",
    "subsurface",
)
"""What the beauty falls into."""

SUMS = {
    "direct": ("emission", "directDiffuse", "directSpecular", "directTransmission"),
    "firstBounce": ("directDiffuse", "directSpecular", "directTransmission"),
    "indirect": ("indirectDiffuse", "indirectSpecular", "indirectTransmission"),
    "diffuse": ("directDiffuse", "indirectDiffuse"),
    "specular": ("directSpecular", "indirectSpecular"),
    "transmission": ("directTransmission", "indirectTransmission"),
    **{cell: (cell,) for cell in CELLS},
}
"""AOVs of light, and of what they are the sum; an AOV `emission+diffuse` is a sum, too."""


def is_sum(name: str) -> bool:
    """Whether an AOV is the sum of named ones, none of which has what another has."""
    cells = [cell for part in name.split("+") for cell in SUMS.get(part, (part, part))]
    return len(set(cells)) == len(cells)


LIGHT_AOV = "light_"
"""What AOVs of a light group, or of one light, are named, before its name; only where asked for."""
