"""Formulas in the place of growths."""

import math

import numpy as np
import pytest

from jaxgrow.calibration.evaluations import Evaluation


class Formula:
    """Two metrics of one parameter k, x = log k, that differ between seeds.

    The slopes are `share` of the true ones, as frozen choices miss a part; above
    `fails_above` no growth ends; after `grows` growths comes Ctrl-C.
    """

    def __init__(self, share=0.5, fails_above=math.inf, grows=math.inf):
        self.share, self.fails_above, self.grows = share, fails_above, grows
        self.asked = []

    def measure(self, seed, values):
        if len(self.asked) >= self.grows:
            raise KeyboardInterrupt
        self.asked.append((seed, values))
        (k,) = values
        if k > self.fails_above:
            return Evaluation(seed, values, "STEP_LIMIT", ())
        x, noise = math.log(k), 0.02 * math.sin(5 * seed + 1)
        return Evaluation(seed, values, "REACHED", (1.3 - 0.4 * x + noise, 2 - 0.5 * x))

    def slopes(self, _, values):
        if self.share is None:
            return ()
        (k,) = values
        return ((-0.4 * self.share / k,), (-0.5 * self.share / k,))


@pytest.fixture
def formula():
    return Formula


class Chaos:
    """Two metrics, -log(k / true), that scatter between any two growths.

    One lesion determines log k to 0.25, whatever its seed. The slopes are four tenths
    of the true ones. Further parameters have no effect.
    """

    def __init__(self, true):
        self.true = true

    def measure(self, seed, values):
        rng = np.random.default_rng([seed, *np.array(values).view(np.uint32)])
        scatter = 0.25 * math.sqrt(2) * rng.standard_normal(2)
        metrics = scatter - math.log(values[0] / self.true)
        return Evaluation(seed, values, "REACHED", tuple(metrics.tolist()))

    def slopes(self, _, values):
        row = (-0.4 / values[0], *[0.0] * (len(values) - 1))
        return row, row


@pytest.fixture
def chaos():
    return Chaos
