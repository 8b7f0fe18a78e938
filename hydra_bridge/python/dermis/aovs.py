"""AOVs beside the beauty, as `flat::RenderSettings::aovs` names them: AOVS by default, GUIDE_AOVS where asked for."""

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
