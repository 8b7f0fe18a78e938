"""Which time codes to record and how their files are called: usdrecord's rules and messages."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pxr import Tf, Usd

if TYPE_CHECKING:
    from pxr import UsdUtils

_PLACEHOLDER = re.compile(r"^[^#]*(?P<placeholder>#+(\.#+)?)[^#]*$")


def placeholder(path: str) -> str | None:
    """The frame placeholder, `###` or `###.###`, of `path`; None unless there is exactly one."""
    match = _PLACEHOLDER.match(path)
    return match["placeholder"] if match else None


def precision(text: str) -> int:
    """Digits after the dot of a number or a placeholder."""
    return len(text.partition(".")[2])


def frame_path(path: str, time: float) -> str:
    """`path` with its placeholder replaced by `time`, zero-padded to the width of the placeholder."""
    mark = placeholder(path)
    if mark is None:
        return path
    return path.replace(mark, f"{time:0{len(mark)}.{precision(mark)}f}")


class Frames(Sequence[Usd.TimeCode]):
    """The time codes of FrameSpecs, in order; made one by one, however many they are."""

    def __init__(self, ranges: list[UsdUtils.TimeCodeRange]) -> None:
        self.ranges = ranges
        self._counts = [frame_count(codes) for codes in ranges]

    def __len__(self) -> int:
        return sum(self._counts)

    def __iter__(self) -> Iterator[Usd.TimeCode]:
        for codes, count in zip(self.ranges, self._counts, strict=True):
            for i in range(count):
                yield time_code(codes, i)

    def __getitem__(self, index: int) -> Usd.TimeCode:
        index += len(self) if index < 0 else 0
        for codes, count in zip(self.ranges, self._counts, strict=True):
            if 0 <= index < count:
                return time_code(codes, index)
            index -= count
        raise IndexError(index)


def frame_count(codes: UsdUtils.TimeCodeRange) -> int:
    """As UsdUtils counts: with a tolerance, for strides that are no binary fractions."""
    start, end = codes.startTimeCode.GetValue(), codes.endTimeCode.GetValue()
    if codes.stride == 0.0:
        return 1
    return math.floor((end - start) / codes.stride + 1e-6) + 1


def time_code(codes: UsdUtils.TimeCodeRange, index: int) -> Usd.TimeCode:
    return Usd.TimeCode(codes.startTimeCode.GetValue() + index * codes.stride)


def parse_frame_specs(specs: str) -> tuple[Frames, int]:
    """Time codes of comma-separated FrameSpecs (`1`, `1:5`, `5:1`, `1:5x0.5`) and the decimals they need.

    Raises ValueError naming the FrameSpec.
    """
    from pxr import UsdUtils  # takes as long to load as a small stage

    ranges: list[UsdUtils.TimeCodeRange] = []
    decimals = 0
    for spec in specs.split(","):
        try:
            codes = UsdUtils.TimeCodeRange.CreateFromFrameSpec(spec)
        except Tf.ErrorException as error:
            raise ValueError(f'Invalid FrameSpec: "{spec}"') from error
        if not codes.IsValid():
            raise ValueError(f'Invalid FrameSpec: "{spec}"')
        ranges.append(codes)
        decimals = max(decimals, precision(spec.partition("x")[2]))
    return Frames(ranges), decimals


def resolve_times(
    parser: argparse.ArgumentParser, args: argparse.Namespace, stage: Usd.Stage, paths: Sequence[str]
) -> Sequence[Usd.TimeCode]:
    """The time codes to record; leaves with a usage error if the file arguments `paths` do not suit them."""
    if not args.frames:
        for name in paths:
            _refuse_placeholder(parser, name, getattr(args, name))
        return [Usd.TimeCode.Default() if args.defaultTime else Usd.TimeCode(stage.GetStartTimeCode())]
    try:
        times, decimals = parse_frame_specs(args.frames)
    except ValueError as error:
        parser.error(str(error))
    for name in paths:
        _require_placeholder(parser, name, getattr(args, name), decimals)
    return times


def _refuse_placeholder(parser: argparse.ArgumentParser, name: str, path: str | None) -> None:
    if path and placeholder(path):
        parser.error(f"{name} cannot contain a frame number placeholder when not operating on a frame range.")


def _require_placeholder(parser: argparse.ArgumentParser, name: str, path: str | None, decimals: int) -> None:
    if not path:
        return
    mark = placeholder(path)
    if mark is None:
        # The stray quotation mark is usdrecord's own; scripts compare its messages.
        parser.error(
            f'{name} must contain exactly one frame number placeholder of the form "###"" or "###.###". '
            "Note that the number of hash marks is variable in each group."
        )
    if precision(mark) < decimals:
        parser.error(
            f"The given FrameSpecs require a minimum floating point precision of {decimals}, but the frame "
            f"placeholder in {name} only specified a precision of {precision(mark)} ({mark}). The precision "
            f"of the frame placeholder must be equal to or greater than {decimals}."
        )
