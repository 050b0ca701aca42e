"""What to grow: organ, lesion and parameters; read, validated and explained.

Lengths of a scene are in millimetres, except in `Surroundings` and `Parameters`, which
speak in r0, the diameter of a particle.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import pydantic

from jaxgrow.energy.parameters import Parameters
from jaxgrow.organ.organ import Organ
from jaxgrow.scene.entries import check_names, Positive, read_toml, validated


SITE_DEFAULT = "fundus"

Site: TypeAlias = str | Annotated[tuple[float, float, float], pydantic.Strict(False)]


class SceneError(ValueError):
    """A scene that cannot be grown; its message is the sentence for the user."""


class _Model(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(
        frozen=True, strict=True, extra="forbid", arbitrary_types_allowed=True
    )


class Lesion(_Model):
    """What polyp and myoma share.

    Attributes:
        size_mm: largest diameter at which growth ends; 10 mm if no number of divisions
            is given either.
        divisions: number of divisions after which growth ends, instead of a size.
        particle_mm: r0, the distance at which two particles rest; the resolution.
            By default a fraction of the size (`particles_across`), or 1 mm.
        site: a named site of the organ, or x, y, z in mm near its surface.
        divisions_per_step: how many particles are born before the next equilibrium, 8
            at most; fewer where there is no room for them. The paper has one. With four
            a polyp of 80 divisions took 0.47 of the time; its mean shape differed by
            less than five seeds can tell (7 % in height).
    """

    size_mm: Positive | None = None
    divisions: Annotated[int, pydantic.Field(ge=1)] | None = None
    particle_mm: Positive | None = None
    site: Site = SITE_DEFAULT
    divisions_per_step: Annotated[int, pydantic.Field(ge=1, le=8)] = 1

    @pydantic.model_validator(mode="after")
    def _one_end(self) -> "Lesion":
        if self.size_mm is not None and self.divisions is not None:
            raise ValueError("give size_mm or divisions, not both")
        return self

    mechanics: ClassVar[dict[str, float]] = {}
    """Parameters of this kind of lesion, where they are not the general defaults."""

    @property
    def particles_across(self) -> float:
        """Particle diameters in the largest diameter of the lesion, by default."""
        return 10.0

    @property
    def target_mm(self) -> float | None:
        """Largest diameter asked for; None if a number of divisions is."""
        if self.divisions is not None:
            return None
        return 10.0 if self.size_mm is None else self.size_mm

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm."""
        if self.particle_mm is not None:
            return self.particle_mm
        return 1.0 if self.target_mm is None else self.target_mm / self.particles_across


class Polyp(Lesion):
    """A local overgrowth of the surface: one of its vertices emits all particles.

    Its size is the largest diameter of the surface raised above the former one.
    """

    kind: Literal["polyp"] = "polyp"


class Myoma(Lesion):
    """A dense ball under the surface: any of its particles may divide.

    Its size is the largest diameter of its body of particles.

    Attributes:
        depth_mm: of its first particle under the surface; a quarter of its size by
            default, so that it protrudes into the lumen.
    """

    mechanics: ClassVar[dict[str, float]] = {"tumour_stiffness": 3.0}

    kind: Literal["myoma"] = "myoma"
    depth_mm: Positive | None = None

    @property
    def particles_across(self) -> float:
        """Particle diameters in the largest diameter of the lesion, by default."""
        return 7.0


class Surroundings(_Model):
    """How much of the organ around the site is simulated, and how finely; in r0.

    Attributes:
        radius: of the patch of surface, along the surface; chosen from the lesion's
            size if None.
        thickness: of the layer of tissue under it; chosen from the lesion if None.
        density: of tissue particles, per r0³.
        max_area: triangles larger than this (in r0²) are subdivided.
        min_area: triangles smaller than this (in r0²) are collapsed.
        collisions: whether the surface repels itself and the other parts of the organ:
            "auto" for as soon as they come near each other, "on" for always, which
            gives the same equilibria, "off" for never.
    """

    radius: Positive | None = None
    thickness: Positive | None = None
    density: Positive = 1.7
    max_area: Positive = 0.7
    min_area: Positive = 0.1
    collisions: Literal["auto", "on", "off"] = "auto"


class Scene(_Model):
    """All that decides a growth, but its seed and tolerance.

    Attributes:
        organ: "uterus" for the built-in one, the path of a mesh file, an `Organ`, or
            None for a lesion that grows freely in space.
        unit_mm: length of one unit of the organ's file, in mm.
        tissue: on which side of the organ's surface its tissue lies: "outside" of a
            hollow organ's inner surface, "inside" of a solid one.
        lesion: a `Polyp` or a `Myoma`.
        parameters: of the mechanics; where none is given, those of the lesion's kind.
        surroundings: of the lesion.
    """

    organ: Organ | Path | str | None = "uterus"
    unit_mm: Positive = 1.0
    tissue: Literal["outside", "inside"] = "outside"
    lesion: Annotated[Polyp | Myoma, pydantic.Field(discriminator="kind")] = Polyp()
    parameters: Parameters = pydantic.Field(default_factory=Parameters)
    surroundings: Surroundings = Surroundings()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _mechanics_of_the_lesion(cls, entries: Any) -> Any:
        given = entries.get("parameters", {})
        if not isinstance(given, dict):
            return entries
        lesion = entries.get("lesion")
        kind = lesion.get("kind") if isinstance(lesion, dict) else lesion
        own = Myoma if kind == "myoma" or isinstance(kind, Myoma) else Polyp
        return {**entries, "parameters": {**own.mechanics, **given}}

    @pydantic.field_validator("parameters", mode="before")
    @classmethod
    def _parameters(cls, value: object) -> object:
        if not isinstance(value, dict):
            return value
        check_names(value, [field.name for field in dataclasses.fields(Parameters)])
        for name, number in value.items():
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise ValueError(f"parameter {name} is {number!r}; give a number")
        return Parameters(**value)

    @pydantic.model_validator(mode="after")
    def _polyps_need_a_surface(self) -> "Scene":
        if self.organ is None and isinstance(self.lesion, Polyp):
            raise ValueError("a polyp grows from a surface: give an organ, or a myoma")
        return self

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm."""
        return self.lesion.r0_mm


def load_scene(path: str | Path) -> Scene:
    """The scene of a TOML file; a relative organ path is relative to that file.

    Raises:
        SceneError: the file cannot be read, is no TOML, or has a wrong entry; the
            message names each with what is wanted.
    """
    return make_scene(read_entries(path), source=str(path))


def read_entries(path: str | Path) -> dict[str, Any]:
    """The entries of a scene file as they stand there, unchecked.

    Raises:
        SceneError: the file cannot be read, or is no TOML.
    """
    path = Path(path)
    entries = read_toml(path, "scene", SceneError)
    organ = entries.get("organ")
    if isinstance(organ, str) and organ != "uterus":
        entries["organ"] = str(path.parent / organ)
    return entries


def make_scene(entries: dict[str, Any], *, source: str) -> Scene:
    """A scene from nested entries as TOML has them.

    Args:
        entries: keys as the fields of `Scene`.
        source: where they come from, for the message.

    Raises:
        SceneError: names every wrong entry with what is wanted.
    """
    return validated(Scene, entries, source=source, error=SceneError)
