"""Metrics of one's own: in reports, as targets of fits, and refused if none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.calibration.evaluations import LesionGrower
from jaxgrow.calibration.spec import make_task
from jaxgrow.io.report import make_report
from jaxgrow.metrics import measure, metric_names


@pytest.fixture
def top_mm(registries):
    @jg.register_metric
    def top_mm(state):
        particles = state.particles
        tumour = particles.alive & (particles.species == jg.Species.TUMOUR)
        highest = jnp.max(jnp.where(tumour, particles.position[:, 2], -jnp.inf))
        return state.frame.particle_mm * highest

    return top_mm


def test_report_has_a_registered_metric_beside_the_others(top_mm, tiny_cluster):
    metrics = make_report(tiny_cluster, None)["outcome"]["metrics"]
    assert metrics["top_mm"] == float(top_mm(tiny_cluster.state))
    shape = jg.shape_metrics(tiny_cluster.state)
    assert metrics["tumour_diameter_mm"] == float(shape.tumour_diameter_mm)


def test_fit_measures_a_registered_metric_and_its_derivative(top_mm):
    scene = jg.Scene(organ=None, lesion=jg.Myoma(divisions=4))
    entries = {
        "targets": {"top_mm": (2.0, 0.1), "tumour_diameter_mm": (3.0, 0.1)},
        "parameters": {"tumour_stiffness": (1.0, 9.0)},
        "fit": {"seeds": [0]},
    }
    grower = LesionGrower(scene, make_task(entries, source="test"))
    measured = grower.measure(0, (3.0,))
    assert measured.metrics[0] == float(top_mm(jg.grow(scene, parameters={}).state))
    ((slope,), _) = grower.slopes(0, (3.0,))
    assert np.isfinite(slope)


def test_metric_that_is_not_registered_is_no_target():
    entries = {"targets": {"top_mm": (2, 1)}, "parameters": {"adhesion": (0.1, 0.3)}}
    with pytest.raises(jg.FitError, match="top_mm"):
        make_task(entries, source="test")
    assert "top_mm" not in metric_names()


def test_chosen_metrics_alone_are_computed(top_mm, tiny_cluster):
    @jg.register_metric
    def broken(state):
        raise AssertionError

    assert list(measure(tiny_cluster.state, ["top_mm"])) == ["top_mm"]


def test_metric_of_a_derivative_is_not_withheld(top_mm, tiny_cluster):
    def metric(scale):
        frame = tiny_cluster.state.frame
        other = frame.__class__(
            frame.origin, frame.axis, scale * frame.particle_mm, frame.former
        )
        state = jg.State(tiny_cluster.state.particles, None, other)
        return measure(state, ["top_mm"])["top_mm"]

    value = float(metric(1.0))
    assert float(jax.grad(metric)(1.0)) == pytest.approx(value, rel=1e-12)


def test_metric_that_is_no_number_is_told(registries, tiny_cluster):
    @jg.register_metric
    def three(state):
        return jnp.zeros(3)

    with pytest.raises(TypeError, match=r"three returned .* shape \(3,\)"):
        measure(tiny_cluster.state, ["three"])


def test_name_of_a_metric_of_the_package_is_refused(registries):
    def height_mm(state):
        return 0.0

    with pytest.raises(ValueError, match="height_mm is one of jaxgrow's"):
        jg.register_metric(height_mm)


@pytest.mark.parametrize("given", [lambda _: 0.0, 3.0])
def test_what_has_no_name_is_no_metric(unchecked, given):
    with pytest.raises(TypeError, match="give a function of a state"):
        unchecked(jg.register_metric)(given)
