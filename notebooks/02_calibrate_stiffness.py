# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Calibrate a stiffness
#
# An expert describes a lesion by its shape: so high, so round. This notebook finds the
# stiffness of the surface's springs with which lesions grow into that shape. It takes
# the derivative of a shape through all of a growth, shows what such a derivative knows
# and what it does not, and then lets `jg.fit` do the work. It needs the extra
# `notebook` and two minutes; to that end the lesions are tiny.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import jaxgrow as jg


jax.config.update("jax_enable_x64", True)
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)

# %% [markdown]
# ## A shape in numbers
#
# 24 divisions at the fundus of the built-in uterus, on a small patch, under a lining
# that bends easily. `shape_metrics` measures the lesion; with `smoothing` its extreme
# values become smooth functions, each length at most so many particle diameters off,
# and differentiable.

# %%
scene = jg.Scene(
    lesion=jg.Polyp(divisions=24, particle_mm=1.5),
    parameters={"bending_stiffness": 0.003},
    surroundings=jg.Surroundings(radius=4),
)


def shape(growth):
    return jg.shape_metrics(growth.state, smoothing=0.1)


growths = [jg.grow(scene, seed=seed) for seed in range(4)]
for seed, growth in enumerate(growths):
    found = shape(growth)
    print(
        f"seed {seed}: height {float(found.height_mm):5.2f} mm, "
        f"sphericity {float(found.sphericity):5.2f}, "
        f"curvature at the tip {float(found.tip_curvature_per_mm):5.2f} / mm"
    )

# %% [markdown]
# The same parameters, other seeds: lesions differ. What parameters mean is therefore a
# mean over lesions, and a fit takes several seeds.
#
# ## The derivative of a growth
#
# `jax.grad` goes through every division, equilibrium and remeshing. The events of the
# growth (who divided, which edges were split, which equilibrium was taken) are
# replayed, so the value belongs to that very lesion.


# %%
def height(stiffness, growth):
    parameters = {"spring_stiffness": stiffness}
    again = jg.grow(scene, parameters=parameters, events=growth.events, tolerance=1e-13)
    return shape(again).height_mm


slopes = [float(jax.grad(height)(0.04, growth)) for growth in growths[:3]]
step = 1e-6 * 0.04
for slope, growth in zip(slopes, growths, strict=False):
    sides = [height(0.04 + side * step, growth) for side in (1, -1)]
    difference = float(sides[0] - sides[1]) / (2 * step)
    print(f"derivative {slope:.6f}, difference {difference:.6f} mm per F(0)/r0")

# %% [markdown]
# ## What it does not know
#
# The derivative is that of a growth whose choices are frozen. Grown anew, a lesion with
# another stiffness chooses otherwise: other edges are split, other packings are taken.
# Single lesions scatter, and their mean need not fall as the mean of the frozen paths
# says; `experiments/studies/gradient_quality.py` measures that with more and larger
# lesions.

# %%
values = 0.04 * 3.0 ** np.array([-1, 0, 1])
heights = np.zeros((len(values), 3))
for row, value in zip(heights, values, strict=True):
    parameters = {"spring_stiffness": float(value)}
    for seed in range(len(row)):
        row[seed] = shape(jg.grow(scene, seed=seed, parameters=parameters)).height_mm
change = np.log(values / 0.04)
figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
axes.semilogx(values, heights, "o", color="0.6")
axes.semilogx(values, heights.mean(axis=1), "k-", label="mean over seeds")
line = heights[1].mean() + 0.04 * np.mean(slopes) * change
axes.semilogx(values, line, "C3--", label="mean of frozen paths")
axes.set(xlabel="spring stiffness [F(0)/r0]", ylabel="height [mm]")
axes.legend()
plt.show()

# %% [markdown]
# ## The fit
#
# Targets are values with the expert's uncertainty, parameters have bounds and here a
# start that is three times too stiff. `jg.fit` begins with the derivative, accepts a
# step only if lesions that are grown anew show that it leads closer, corrects the
# sensitivities by what they show, and ends when a further step would be lost in the
# scatter over seeds. All growths are kept in the folder: an interrupted fit goes on
# from them.

# %%
means = np.mean(
    [(shape(g).height_mm, shape(g).tip_curvature_per_mm) for g in growths], axis=0
)
targets = {
    "height_mm": (float(means[0]), 0.3),
    "tip_curvature_per_mm": (float(means[1]), 0.05),
}
found = jg.fit(
    scene,
    targets,
    {"spring_stiffness": jg.Bounds(low=0.005, high=0.5, start=0.12)},
    seeds=range(10, 16),
    evaluations=4,
    folder=folder / "fit",
    progress=lambda tried: print(f"{tried.values[0]:.4f}: loss {tried.loss:.3g}"),
)
print(found.outcome.value)

# %% [markdown]
# ## What it knows now
#
# The uncertainty has two parts: what the targets leave open, and what so few seeds do.
# The targets were the means of four lesions with a stiffness of 0.04, and four such
# tiny lesions may well look like those of half or twice the stiffness. Larger lesions,
# and more of them, determine it to some per cent: `experiments/studies/calibration.py`.

# %%
stiffness = found.parameters["spring_stiffness"]
print(f"stiffness {stiffness.value:.4f}, {stiffness.low:.4f} to {stiffness.high:.4f}")
print(f"± {stiffness.from_targets:.4f} of the targets")
print(f"± {stiffness.from_seeds:.4f} of the seeds")
for name, target in found.targets.items():
    print(f"{name}: {target.achieved:.3f} for {target.target:.3f}")
Image.open(folder / "fit" / "fit.png")

# %% [markdown]
# `found.scene` has the fitted value, and so has the scene file in the folder, for
# `jaxgrow grow fitted.toml --out DIR`.

# %%
print((folder / "fit" / "fitted.toml").read_text())
