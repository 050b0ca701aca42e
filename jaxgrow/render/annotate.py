"""Annotation of pictures: scale bar, legend, caption."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from jaxtyping import UInt8

from jaxgrow.runtime.atomic_file import write_atomically


INK = (40, 40, 40)

# Shape (``disc`` or ``line``), colour and name.
Entry = tuple[str, tuple[int, int, int], str]


def write_page(
    path: str | os.PathLike[str],
    panels: list[UInt8[np.ndarray, "a b 3"]],
    *,
    field: float,
    entries: list[Entry],
    caption: str | None,
) -> None:
    """Write panels side by side, with annotation below, as a PNG.

    Args:
        path: The PNG file, written atomically.
        panels: The pictures, all of one size.
        field: Width of the field that each of them shows, mm.
        entries: The last panel's legend.
        caption: A line below everything.
    """
    from PIL import Image

    height, side = panels[0].shape[:2]
    gap = side // 45
    width = len(panels) * (side + gap) - gap
    foot = _foot(width, side, field, entries, caption)
    image = Image.new("RGB", (width, height + foot.height), "white")
    for number, panel in enumerate(panels):
        image.paste(Image.fromarray(panel), (number * (side + gap), 0))
    image.paste(foot, (0, height))
    write_atomically(path, lambda file: image.save(file, format="PNG"))


def _foot(
    width: int, side: int, field: float, entries: list[Entry], caption: str | None
) -> Any:
    """Draw scale bar, legend and caption, at twice the size, and halve it."""
    from PIL import Image, ImageDraw

    text = max(18, side // 18)
    row = 2 * text
    height = (row + text // 2) if caption is None else (2 * row + text // 2)
    image = Image.new("RGB", (2 * width, height + height % 2), "white")
    draw = ImageDraw.Draw(image)
    middle = row // 2 + text // 4
    _scale_bar(draw, middle, per_mm=2 * side / field, length=field / 5, text=text)
    left = 2 * (width - side) if width > side else width
    _legend(draw, entries, left=left, right=2 * width, middle=middle, text=text)
    if caption is not None:
        room = 2 * width - text
        while text > 12 and draw.textlength(caption, _font(text)) > room:
            text -= 1
        draw.text((text // 2, middle + row), caption, INK, _font(text), anchor="lm")
    return image.reduce(2)


def _scale_bar(
    draw: Any, middle: int, *, per_mm: float, length: float, text: int
) -> None:
    """Draw a bar of a round number of millimetres at the left."""
    length = round_length(length)
    left, thick = text // 2, max(2, text // 8)
    right = left + round(length * per_mm)
    draw.rectangle((left, middle - thick // 2, right, middle + thick // 2), fill=INK)
    for end in (left, right):
        draw.rectangle(
            (
                end - thick // 2,
                middle - 2 * thick,
                end + thick // 2,
                middle + 2 * thick,
            ),
            fill=INK,
        )
    words = f"{length:g} mm"
    draw.text((right + text // 2, middle), words, INK, _font(text), anchor="lm")


def _legend(
    draw: Any, entries: list[Entry], *, left: int, right: int, middle: int, text: int
) -> None:
    """Draw names beside their colours, smaller if space is short."""
    words = "".join(name for _, _, name in entries)
    room = right - left
    while (
        text > 12
        and draw.textlength(words, _font(text)) + 3 * text * len(entries) > room
    ):
        text -= 1
    font, radius = _font(text), 0.42 * text
    for shape, colour, name in entries:
        if shape == "disc":
            box = (left, middle - radius, left + 2 * radius, middle + radius)
            draw.ellipse(box, fill=colour, outline=INK, width=max(1, text // 16))
        else:
            draw.line((left, middle, left + 1.3 * text, middle), colour, text // 5)
        left += round((0.84 if shape == "disc" else 1.3) * text + 0.4 * text)
        draw.text((left, middle), name, INK, font, anchor="lm")
        left += round(draw.textlength(name, font) + text)


def round_length(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not longer."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1, 2, 5) if step * power <= length * 1.0001)


def _font(text: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size=text)
