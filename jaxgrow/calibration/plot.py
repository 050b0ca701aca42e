"""Plot of a fit: loss by evaluation, and targets with achieved values."""

import math
from pathlib import Path
from typing import Any

from jaxgrow.calibration.outcome import Fit
from jaxgrow.runtime.atomic_file import write_atomically


_WIDTH, _HEIGHT, _SCALE = 1000, 420, 2  # pixels; drawn at twice the size
_INK, _PALE, _BLUE, _RED = (40, 40, 40), (205, 205, 205), (31, 98, 170), (190, 60, 40)
_REACH = 4.0  # uncertainties to either side of a target


def draw_fit(fit: Fit, path: Path) -> None:
    """Write the plot of a fit as a PNG, atomically.

    Left: the loss of every evaluation's own lesions, a filled disc where it was
    accepted, a hollow one where it was refused, a red one at the top where a growth
    failed; a line at the least so far. A step is accepted by the loss estimated from
    all lesions (`jaxgrow.calibration.loss.Estimate`), so a disc may lie above the line.
    Right: the distance from every target in its uncertainties, with the standard
    deviation of one lesion over the seeds, and a grey band where a target is reached.
    """
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (_WIDTH * _SCALE, _HEIGHT * _SCALE), "white")
    draw = ImageDraw.Draw(image)
    half = _WIDTH * _SCALE // 2
    bottom = (_HEIGHT - 70) * _SCALE
    _losses(draw, fit, (95 * _SCALE, 50 * _SCALE, half - 30 * _SCALE, bottom))
    right = 2 * half - 30 * _SCALE
    _targets(draw, fit, (half + 190 * _SCALE, 50 * _SCALE, right, bottom))
    small = image.reduce(_SCALE)
    write_atomically(path, lambda file: small.save(file, format="PNG"))


Box = tuple[int, int, int, int]


def _losses(draw: Any, fit: Fit, box: Box) -> None:
    left, top, right, bottom = box
    finite = [max(t.loss, 1e-6) for t in fit.history if math.isfinite(t.loss)]
    powers = [math.log10(loss) for loss in finite] or [0.0]
    low, high = math.floor(min(powers)), math.ceil(max(powers) + 1e-9)
    high = max(high, low + 1)
    last = max(1, len(fit.history) - 1)

    def place(number: int, loss: float) -> tuple[float, float]:
        share = (math.log10(max(loss, 1e-6)) - low) / (high - low)
        inner = right - left - 30 * _SCALE
        return left + 15 * _SCALE + inner * number / last, bottom - share * (
            bottom - top
        )

    _frame(draw, box, "loss of each evaluation's own lesions")
    for power in range(low, high + 1):
        _, y = place(0, 10.0**power)
        draw.line((left, y, right, y), _PALE, _SCALE)
        _text(draw, left - 8 * _SCALE, y, f"{10.0**power:g}", "rm")
    for number in sorted({0, last // 2, len(fit.history) - 1}):
        x, _ = place(number, 1)
        _text(draw, x, bottom + 14 * _SCALE, str(number), "mm")
    caption = "filled: accepted, hollow: refused, red: failed, line: least so far"
    _text(draw, (left + right) / 2, bottom + 40 * _SCALE, caption, "mm")
    best, line = math.inf, list[tuple[float, float]]()
    for tried in fit.history:
        before, best = best, min(best, tried.loss)
        if math.isfinite(before):
            line.append(place(tried.number, before))
        if math.isfinite(best):
            line.append(place(tried.number, best))
    if len(line) > 1:
        draw.line(line, _BLUE, 2 * _SCALE)
    for tried in fit.history:
        if math.isfinite(tried.loss):
            fill = _BLUE if tried.accepted else (255, 255, 255)
            _disc(draw, *place(tried.number, tried.loss), fill, _BLUE)
        else:
            _disc(draw, place(tried.number, 1)[0], top, _RED, _RED)


def _targets(draw: Any, fit: Fit, box: Box) -> None:
    left, top, right, bottom = box

    def across(residual: float) -> float:
        clipped = max(-_REACH, min(_REACH, residual))
        return (left + right) / 2 + clipped / _REACH * (right - left) / 2

    _frame(draw, box, "achieved - target, in uncertainties")
    draw.rectangle((across(-1), top, across(1), bottom), (232, 236, 240))
    for tick in range(-int(_REACH), int(_REACH) + 1):
        draw.line((across(tick), top, across(tick), bottom), _PALE, _SCALE)
        _text(draw, across(tick), bottom + 14 * _SCALE, str(tick), "mm")
    caption = "bars: one lesion (± its spread over seeds)"
    _text(draw, (left + right) / 2, bottom + 40 * _SCALE, caption, "mm")
    step = (bottom - top) / max(1, len(fit.targets))
    for number, (name, target) in enumerate(fit.targets.items()):
        y = top + (number + 0.5) * step
        size = 12 if step > 34 * _SCALE else 9
        wanted = f"{target.target:.4g} ± {target.uncertainty:.2g}"
        words = f"{target.achieved:.3g} of {wanted}"
        _text(draw, left - 8 * _SCALE, y - 0.6 * size * _SCALE, name, "rm", size)
        _text(draw, left - 8 * _SCALE, y + 0.6 * size * _SCALE, words, "rm", size)
        colour = _BLUE if target.reached else _RED
        if math.isfinite(target.spread):
            bar = target.spread / target.uncertainty
            ends = (across(target.residual - bar), across(target.residual + bar))
            draw.line((ends[0], y, ends[1], y), colour, 2 * _SCALE)
        _disc(draw, across(target.residual), y, colour, colour)


def _frame(draw: Any, box: Box, title: str) -> None:
    left, top, right, _ = box
    draw.rectangle(box, None, _PALE, _SCALE)
    _text(draw, (left + right) / 2, top - 22 * _SCALE, title, "mm", 15)


def _disc(draw: Any, x: float, y: float, fill: Any, outline: Any) -> None:
    r = 4.5 * _SCALE
    draw.ellipse((x - r, y - r, x + r, y + r), fill, outline, _SCALE)


def _text(
    draw: Any, x: float, y: float, words: str, anchor: str, size: int = 12
) -> None:
    from PIL import ImageFont

    font = ImageFont.load_default(size=size * _SCALE)
    draw.text((x, y), words, _INK, font, anchor=anchor)
