"""The loss, and what evaluations say of points near them."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.calibration.coordinates import Coordinates
from jaxgrow.calibration.evaluations import Evaluation, Growths
from jaxgrow.calibration.loss import Loss, RIDGE
from jaxgrow.calibration.spec import make_task


TARGETS = {"height_mm": (2.0, 0.5), "width_mm": (1.0, 0.25)}
TWO = {"spring_stiffness": (0.004, 0.4), "adhesion": (0.05, 0.35)}


class Sheet:
    """Metrics linear in the unconstrained coordinates, with an offset per seed."""

    def __init__(self, coordinates, slope, without=()):
        self.coordinates, self.slope = coordinates, np.array(slope, float)
        self.without = without

    def measure(self, seed, values):
        u = np.asarray(self.coordinates.coordinates(jnp.asarray(values)))
        metrics = self.slope @ u + np.array([0.1, -0.2]) * seed
        return Evaluation(seed, values, "REACHED", tuple(metrics.tolist()))

    def slopes(self, seed, values):
        if seed in self.without:
            return ()
        u = self.coordinates.coordinates(jnp.asarray(values))
        along = np.asarray(self.coordinates.slopes(u))
        return tuple(map(tuple, (self.slope / along).tolist()))


def make_loss(parameters, slope, seeds=(0, 1, 3), **more):
    entries = {"targets": TARGETS, "parameters": parameters, "fit": {"seeds": seeds}}
    task = make_task(entries, source="test")
    coordinates = Coordinates.between(task.parameters.values())
    return Loss(task, coordinates, Growths(Sheet(coordinates, slope, **more), {}))


ONE = {"spring_stiffness": (0.004, 0.4)}
STEEP = [[1.5], [-0.5]]


def test_the_loss_is_that_of_the_mean():
    loss = make_loss(ONE, STEEP)
    found = loss(np.array([0.4]))
    mean = np.array([0.6, -0.2]) + np.array([0.1, -0.2]) * 4 / 3
    residual = (mean - [2.0, 1.0]) / [0.5, 0.25]
    assert found.loss == pytest.approx(residual @ residual / 2)
    assert loss.grown == [found]


def test_a_point_alone_has_its_own_residuals_and_the_frozen_slopes():
    loss = make_loss(ONE, STEEP)
    at = loss(np.array([0.4]))
    frozen = loss.frozen(at)
    assert frozen is not None
    np.testing.assert_allclose(frozen, np.array(STEEP) / [[0.5], [0.25]])
    estimate = loss.estimate(at.u, 0.3 * frozen)
    wanted = (at.metrics - [2.0, 1.0]) / [0.5, 0.25]
    np.testing.assert_allclose(estimate.residuals, wanted)
    np.testing.assert_allclose(estimate.jacobian, 0.3 * frozen)
    assert estimate.loss == pytest.approx(at.loss)
    assert not estimate.informed


def test_two_points_give_the_ridge_regression_by_hand():
    loss = make_loss(ONE, STEEP, seeds=(0,))
    first, second = loss(np.array([0.0])), loss(np.array([0.8]))
    estimate = loss.estimate(first.u, np.zeros((2, 1)))
    # centred: the weights of the two points leave w d² of information on the slope
    weight = math.exp(-0.64)
    told = weight / (1 + weight) * 0.64
    difference = (second.metrics[0] - first.metrics[0]) / [0.5, 0.25] / 0.8
    slope = told / (told + RIDGE) * difference
    np.testing.assert_allclose(estimate.jacobian[:, 0], slope)
    residual = (first.metrics[0] - [2.0, 1.0]) / [0.5, 0.25]
    share = weight / (1 + weight)
    np.testing.assert_allclose(
        estimate.residual, residual + share * 0.8 * (difference - slope)
    )
    assert estimate.informed == (told > RIDGE)


def test_it_is_informed_only_if_evaluations_span_every_direction():
    slope = [[1.0, 0.5], [0.2, -1.0]]
    loss = make_loss(TWO, slope)
    for u in ((0.0, 0.0), (0.6, 0.0), (-0.6, 0.0)):
        at = loss(np.array(u))
    assert not loss.estimate(at.u, np.zeros((2, 2))).informed
    for u in ((0.0, 0.7), (0.0, -0.7)):
        at = loss(np.array(u))
    estimate = loss.estimate(np.zeros(2), np.zeros((2, 2)))
    assert estimate.informed
    wanted = np.array(slope) / [[0.5], [0.25]]
    np.testing.assert_allclose(estimate.jacobian, wanted, rtol=0.1)


def test_errors_are_covariances_of_the_mean_over_seeds():
    loss = make_loss(ONE, STEEP)
    estimate = loss.estimate(loss(np.array([0.4])).u, np.zeros((2, 1)))
    offset = np.outer([0, 1, 3], np.array([0.1, -0.2]) / [0.5, 0.25])
    wanted = np.cov(offset, rowvar=False) / 3
    np.testing.assert_allclose(estimate.residual_error, wanted)
    # every seed has the same slope here
    np.testing.assert_allclose(estimate.gradient_error, 0, atol=1e-12)
    np.testing.assert_allclose(estimate.information, estimate.curvature)


def test_information_is_less_than_curvature_where_seeds_disagree():
    loss = make_loss(ONE, STEEP)
    at = loss(np.array([0.4]))
    estimate = loss.estimate(at.u, np.zeros((2, 1)))
    jacobians = np.array([[[1.0], [0.0]], [[2.0], [0.0]], [[3.0], [0.0]]])
    estimate = estimate._replace(jacobians=jacobians)
    assert estimate.curvature == pytest.approx(4.0)
    assert estimate.information == pytest.approx(4.0 - 1 / 3)
    noise = estimate._replace(jacobians=jacobians - [[2.0], [0.0]])
    assert noise.information == 0


def test_one_seed_tells_nothing_of_errors():
    loss = make_loss(ONE, STEEP, seeds=(2,))
    estimate = loss.estimate(loss(np.array([0.4])).u, np.zeros((2, 1)))
    np.testing.assert_array_equal(estimate.residual_error, np.zeros((2, 2)))


def test_seeds_without_derivatives_are_left_out():
    loss = make_loss(ONE, STEEP, without=(1,))
    at = loss(np.array([0.4]))
    np.testing.assert_allclose(loss.frozen(at), np.array(STEEP) / [[0.5], [0.25]])
    none = make_loss(ONE, STEEP, without=(0, 1, 3))
    assert none.frozen(none(np.array([0.4]))) is None
