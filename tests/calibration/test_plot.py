"""The plot of a fit: a mark for every evaluation and every target."""

import math

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from jaxgrow.calibration import fit
from jaxgrow.calibration.plot import draw_fit
from jaxgrow.scene.scene import Scene


BOUNDS = {"spring_stiffness": (0.004, 0.4)}
TARGETS = {"height_mm": (2.0, 0.05), "width_mm": (2.9, 0.05)}
LEFT = (slice(40, 360), slice(85, 480))
RIGHT = (slice(40, 360), slice(685, 980))
BLUE, RED, WHITE = (31, 98, 170), (190, 60, 40), (255, 255, 255)


def sizes(mask):
    """Of the connected areas, in pixels."""
    areas = np.zeros(mask.shape, int)
    ndimage.label(mask, output=areas)
    return np.bincount(areas.ravel())[1:]


def discs(pixels, colour):
    """How many; lines are too thin for an erosion."""
    same = (pixels == colour).all(axis=-1)
    return len(sizes(ndimage.binary_erosion(same, np.ones((5, 5)))))


def circles(pixels):
    """Small white areas with something all round them."""
    return sum(15 < size < 60 for size in sizes((pixels == WHITE).all(axis=-1)))


@pytest.mark.parametrize(
    "fails_above, evaluations, outcome, kinds",
    [
        (0.1, 30, "UNREACHED", {"accepted", "refused", "failed"}),
        (math.inf, 1, "UNREACHED", {"accepted"}),
        (0.0, 8, "NOT_GROWN", {"failed"}),
        (0.0, 1, "NOT_GROWN", {"failed"}),
    ],
)
def test_every_evaluation_and_target_has_its_mark(
    fails_above, evaluations, outcome, kinds, formula, tmp_path
):
    grower = formula(1.5, fails_above=fails_above)
    found = fit(Scene(), TARGETS, BOUNDS, grower=grower, evaluations=evaluations)
    assert found.outcome.name == outcome
    draw_fit(found, tmp_path / "fit.png")
    with Image.open(tmp_path / "fit.png") as picture:
        pixels = np.asarray(picture.convert("RGB"))
    wanted = {
        "accepted": sum(t.accepted for t in found.history),
        "failed": sum(t.metrics is None for t in found.history),
    }
    wanted["refused"] = len(found.history) - sum(wanted.values())
    assert {kind for kind, number in wanted.items() if number} == kinds
    assert discs(pixels[LEFT], BLUE) == wanted["accepted"]
    assert circles(pixels[LEFT]) == wanted["refused"]
    assert discs(pixels[LEFT], RED) == wanted["failed"]
    reached = sum(target.reached for target in found.targets.values())
    assert discs(pixels[RIGHT], BLUE) == reached
    assert discs(pixels[RIGHT], RED) == len(found.targets) - reached
