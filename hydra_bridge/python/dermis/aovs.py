"""AOVs beside the beauty, as `flat::RenderSettings::aovs` names them."""

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
