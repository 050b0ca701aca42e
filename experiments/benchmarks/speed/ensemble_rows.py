"""Rows of whole lesions: several divisions for each equilibrium, several members."""

import statistics
from collections.abc import Iterator

import numpy as np

import jaxgrow as jg
from jaxgrow.ensemble.worker_pool import end_kept

from .measure import measure_in_turns, Options, Row


METRICS = ("height_mm", "width_mm", "neck_width_mm", "volume_mm3", "area_mm2")


def polyp(divisions: int, per_step: int = 1) -> jg.Scene:
    """A polyp with particles of 1 mm in the built-in uterus."""
    return jg.Scene(
        lesion=jg.Polyp(
            divisions=divisions, particle_mm=1.0, divisions_per_step=per_step
        ),
        surroundings=jg.Surroundings(radius=5.0),
    )


def shapes(growths: list[jg.Growth]) -> np.ndarray:
    """Metrics of each growth, a row each."""
    measured = [jg.shape_metrics(growth.state, smoothing=0.0) for growth in growths]
    return np.array([[float(getattr(m, name)) for name in METRICS] for m in measured])


def divisions_per_step(options: Options) -> Iterator[Row]:
    """2, 4 and 8 divisions for each equilibrium against 1, the same seeds.

    The error is that of the mean over the seeds, relative, beside its standard error.
    """
    divisions, counts = (24, (1, 2, 4)) if options.quick else (80, (1, 2, 4, 8))
    scenes = {count: polyp(divisions, count) for count in counts}
    for seed in range(options.repetitions):  # each has programs of its own, maybe
        for scene in scenes.values():
            jg.grow(scene, seed=seed)
    measured = measure_in_turns(
        {
            str(count): lambda seed, s=scene: jg.grow(s, seed=seed)
            for count, scene in scenes.items()
        },
        options,
        shortest=0.0,
    )
    found = {name: shapes(growths) for name, growths in measured.outcomes.items()}
    for count in counts[1:]:
        one, many = found["1"], found[str(count)]
        mean = one.mean(axis=0)
        spread = [a.std(axis=0, ddof=1) / np.sqrt(len(a)) for a in (one, many)]
        error = (many.mean(axis=0) - mean) / mean
        scatter = np.hypot(*spread) / mean
        yield Row(
            f"divisions-per-step-{count}",
            f"a polyp of {divisions} divisions, {count} over 1 a step",
            **measured.compare(str(count), "1"),
            errors={
                "relative_difference_of_the_mean": dict(
                    zip(METRICS, error.tolist(), strict=True)
                ),
                "its_standard_error": dict(zip(METRICS, scatter.tolist(), strict=True)),
            },
            details={
                "results": {
                    name: [growth.result.name for growth in growths]
                    for name, growths in measured.outcomes.items()
                },
                "steps_of_relaxation": {
                    name: statistics.median(
                        sum(record.steps for record in growth.history)
                        for growth in growths
                    )
                    for name, growths in measured.outcomes.items()
                },
            },
        )


def ensemble(options: Options) -> Iterator[Row]:
    """Members in this process and another one, over one after the other in this one.

    The other process waits for it since the call before, or has to start.
    """
    members, divisions = (4, 24) if options.quick else (8, 200)
    scene = polyp(divisions)

    def grown(processes: int) -> list[jg.Growth]:
        return list(jg.grow_many(scene, seeds=range(members), processes=processes))

    def started() -> list[jg.Growth]:
        end_kept()
        return grown(2)

    measured = measure_in_turns(
        {
            "start": lambda _: started(),
            "two": lambda _: grown(2),
            "one": lambda _: grown(1),
        },
        options.limited(),
        shortest=0.0,
    )
    one = shapes(measured.outcomes["one"][-1])
    for name, way, bar in (("two", "", 1.8), ("start", "-start", None)):
        two = shapes(measured.outcomes[name][-1])
        yield Row(
            f"ensemble{way}",
            f"{members} polyps of {divisions} divisions: one after the other over two "
            f"processes, {'start included' if way else 'in a second call'}",
            # seconds only: those of the processor leave out the other processes
            ratios=measured.compare("one", name)["ratios"],
            bar=bar,
            side="least",
            seconds={key: measured.seconds[key] for key in (name, "one")},
            errors={"largest_relative_difference": float(np.abs(two / one - 1).max())},
            details={"members": members, "divisions": divisions},
        )
