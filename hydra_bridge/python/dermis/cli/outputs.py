"""Which files a frame makes: OUTPUT, and those of the stage's RenderProducts; views that several of them share."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Usd

from dermis.products import Product, product_aovs

from .arguments import IMAGE_EXTENSIONS
from .frames import frame_path
from .output import OutputError
from .settings import Settings


@dataclass
class Output:
    """A file of a frame; `layers` as the core writes them, None: every AOV of the render."""

    file: str
    layers: list[dict[str, Any]] | None = None
    #: Path of the RenderProduct; empty: none.
    product: str = ""
    #: Its productName, as authored.
    product_name: str = ""
    #: What the product authors itself.
    settings: Settings = field(default_factory=dict)


@dataclass
class View:
    """One render: its settings, and the files that are made of it."""

    settings: Settings
    outputs: list[Output]
    #: Path of the camera; empty where the stage is framed.
    camera: str = ""


def planned(
    file: str | None,
    products: Sequence[Product],
    has_frames: bool = False,
    when: Usd.TimeCode | None = None,
    typed_aovs: bool = False,
    tile: int | None = None,
) -> list[Output]:
    """The files of a frame; `file` (OUTPUT) takes the place of the first product. Each `tile` of a product has a file.

    Raises OutputError where a product names no image file, or one file is named twice.
    """
    outputs = []
    for number, product in enumerate(products):
        name = file if number == 0 and file else product_file(product, has_frames, when, tile)
        layers = None if typed_aovs else product.layers
        outputs.append(Output(name, layers, product.path, product.name, product.settings))
    if not products and file:
        outputs = [Output(file)]
    for i, output in enumerate(outputs):
        if any(Path(output.file).absolute() == Path(other.file).absolute() for other in outputs[:i]):
            raise OutputError(
                f"{output.product}: productName: {output.file} is made by another product already"
            )
    return outputs


def product_file(product: Product, has_frames: bool, when: Usd.TimeCode | None, tile: int | None) -> str:
    if Path(product.name).suffix.lower() not in IMAGE_EXTENSIONS:
        kinds = ", ".join(IMAGE_EXTENSIONS)
        raise OutputError(f"{product.path}: productName: {product.name!r} must end in one of {kinds}")
    name = frame_path(product.name, when.GetValue()) if has_frames and when is not None else product.name
    # As husk names them: tiles must not replace each other.
    return name if tile is None else str(Path(name).with_stem(f"{Path(name).stem}_tile{tile:02}"))


def grouped(outputs: Sequence[Output]) -> list[list[Output]]:
    """Outputs that one render serves: whose products author the same settings. At least one group."""
    groups: list[list[Output]] = []
    for output in outputs:
        group = next((group for group in groups if group[0].settings == output.settings), None)
        if group is None:
            groups.append([output])
        else:
            group.append(output)
    return groups or [[]]


def shared_aovs(outputs: Sequence[Output]) -> Settings:
    """The AOVs that the layers of these outputs need; nothing where one of them takes what the settings say."""
    if not outputs or any(output.layers is None for output in outputs):
        return {}
    return {
        "aovs": list(dict.fromkeys(aov for output in outputs for aov in product_aovs(output.layers or [])))
    }
