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
# # A first polyp
#
# This notebook grows a polyp into the wall of a uterus, looks at it, checks it, and
# changes one of the laws that shape it. It needs the extra `notebook`
# (`pip install 'jaxgrow[notebook]'`), no input and about a minute. To that end the
# polyp is small, the resolution coarse and the tolerance wide; leave `particle_mm` and
# `tolerance` out for results to keep.
#
# Growth is a sequence of some hundred equilibria, each the start of the next, so
# rounding errors must stay far below the force tolerance: JAX has to compute with
# 64-bit numbers, which is switched on before anything else.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
from PIL import Image

import jaxgrow as jg


jax.config.update("jax_enable_x64", True)
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)

# %% [markdown]
# ## The organ
#
# An organ is a closed triangle mesh in millimetres with named sites.
# `jg.load_organ(file)` reads one; `jg.uterus()` makes the cavity of a distended uterus.
# The picture looks through the near wall, from the front: the fundus is at the top,
# the cervix at the bottom.

# %%
organ = jg.uterus()
print(f"{organ.name}: {len(organ.vertices)} vertices, {len(organ.faces)} triangles")
for name, point in organ.sites.items():
    print(f"{name:>12}: x {point[0]:6.1f}  y {point[1]:6.1f}  z {point[2]:6.1f} mm")
jg.render_surface(
    folder / "organ.png", organ.vertices, organ.faces, inside=True, size=450
)
Image.open(folder / "organ.png")

# %% [markdown]
# ## The scene
#
# A scene says what grows where: organ, lesion and mechanics. Only a patch of the
# surface around the site, and the tissue under it, will be simulated. `particle_mm` is
# the diameter of a particle and so the resolution; by default it is a tenth of the
# lesion's size. The parameters of the mechanics are printed; `help(jg.Parameters)`
# explains them and gives their units.

# %%
polyp = jg.Polyp(size_mm=8, site="fundus", particle_mm=1.6)
scene = jg.Scene(organ=organ, lesion=polyp)
vars(scene.parameters)

# %% [markdown]
# ## Growth
#
# Each step adds one tumour particle under the source vertex of the polyp, lets
# particles and surface relax to their common equilibrium, and fairs the surface. The
# seed decides all random choices. `tolerance` is the largest force left in an
# equilibrium, in units of the repulsion of two particles at one point. The first line
# takes a while, as JAX compiles the relaxation and the tissue is brought to rest.


# %%
def report(progress):
    if progress.divisions % 10 == 0:
        print(f"{progress.divisions:4} divisions: {progress.size_mm:4.1f} mm")


growth = jg.grow(scene, seed=0, tolerance=1e-2, progress=report)
print(growth.result)

# %% [markdown]
# ## What came back
#
# A growth carries why it ended, the size reached (the largest diameter of the surface
# raised above the former one), the final state, and the metrics of the lesion's shape,
# each with its unit in its name.

# %%
print(f"{growth.result.name}: {growth.size_mm:.1f} of {polyp.size_mm:g} mm")
print(f"{growth.events.divisions} divisions")
shape = vars(jg.shape_metrics(growth.state))
for name, value in shape.items():
    print(f"{name:>22}: {float(value):8.2f}")

# %% [markdown]
# ## The folder and its picture
#
# `jg.write_run` writes the whole organ with the lesion, the particles, a report, and
# the picture below, shown at half its size. Left is the surface as an endoscope meets
# it; right is a cut along the axis of the polyp, with tumour and tissue particles under
# the surface.

# %%
jg.write_run(growth, folder / "polyp", formats=("ply", "stl"))
for file in sorted((folder / "polyp").iterdir()):
    print(f"{file.name:>14}: {file.stat().st_size / 1000:6.0f} kB")
Image.open(folder / "polyp" / "growth.png").reduce(2)

# %% [markdown]
# ## The audit
#
# The audit measures the result again with exact distances that the simulation does not
# use: particles that crossed the surface, edges that are not shared by two triangles,
# flipped, degenerate or intersecting triangles, a changed topology, values that are
# not finite.

# %%
audit = jg.audit(growth)
print(f"{audit.particles} particles, {audit.surface.faces} triangles checked")
print("clean" if audit.clean else audit.defects)

# %% [markdown]
# ## The history
#
# `growth.history` has one record a division. Size is zero until the first vertices rise
# high enough to count as lesion, and then goes up in small jumps; the steps count the
# iterations that each relaxation took.

# %%
divisions = [record.division for record in growth.history]
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
left.plot(divisions, [record.size_mm for record in growth.history])
left.set(xlabel="division", ylabel="size [mm]")
right.plot(divisions, [record.steps for record in growth.history])
right.set(xlabel="division", ylabel="steps of the relaxation", ylim=(0, None))
plt.show()

# %% [markdown]
# ## Another law
#
# One parameter is changed, everything else stays: the springs of the surface become
# four times as stiff. The polyp takes more divisions, and its neck becomes wider.

# %%
stiff = {"spring_stiffness": 4 * scene.parameters.spring_stiffness}
stiff_growth = jg.grow(scene, seed=0, tolerance=1e-2, parameters=stiff)
stiff_shape = vars(jg.shape_metrics(stiff_growth.state))
print(f"{'':>22}  {'default':>8}  {'stiff':>8}")
print(
    f"{'divisions':>22}  {growth.events.divisions:8}  {stiff_growth.events.divisions:8}"
)
for name, value in shape.items():
    print(f"{name:>22}  {float(value):8.2f}  {float(stiff_shape[name]):8.2f}")

# %% [markdown]
# ## The mesh in other programs
#
# The files in the folder load anywhere. In Python, `growth.mesh()` is the whole organ
# as a `trimesh.Trimesh`, closed and in one piece, with a label for each vertex: 0 is
# healthy, 1 is lesion.

# %%
mesh = growth.mesh()
label = mesh.vertex_attributes["label"]
print(f"closed: {mesh.is_watertight}, Euler number {mesh.euler_number}")
print(f"{len(mesh.vertices)} vertices, {label.sum()} of them in the lesion")
