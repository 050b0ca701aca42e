"""What the static site has besides the guides: a hook of mkdocs.

README, contributors' guide and changelog are pages of the site, pictures lie beside
them, and the reference lists all public names by the folder that they come from.
"""

import ast
import os
import re
from pathlib import Path
from typing import Any

from griffe import Extension
from mkdocs.structure.files import File


ROOT = Path(__file__).parents[2]

PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}
PAGES |= {"CHANGELOG.md": "changelog.md"}

TITLES = {
    "scene": "Scenes: what to grow",
    "lesions": "Kinds of lesions",
    "growth": "Growth",
    "ensemble": "Several growths at once",
    "metrics": "Metrics of shape",
    "calibration": "Calibration",
    "io": "Files, reports and audits",
    "organ": "Organs",
    "render": "Pictures",
    "equilibrium": "Equilibria and their derivatives",
    "energy": "Energies and parameters",
    "state": "The state",
    "transfer": "Particles and membranes of your own",
    "runtime": "Outcomes, programs and warnings",
}


def on_files(files: Any, config: Any) -> Any:
    """Add the pages and pictures that lie outside of the guides' folder."""
    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text()))
    for picture in (ROOT / "experiments/results").glob("*.png"):
        place = f"results/{picture.name}"
        files.append(File.generated(config, place, abs_src_path=str(picture)))
    citation = str(ROOT / "CITATION.cff")
    files.append(File.generated(config, "CITATION.cff", abs_src_path=citation))
    files.append(File.generated(config, "reference.md", content=reference()))
    return files


def on_page_markdown(text: str, *, page: Any, **_: Any) -> str:
    """Let links lead to the pages of the site, from where they lead on the disk."""
    outside = {page: ROOT / name for name, page in PAGES.items()}
    source = outside.get(page.file.src_uri, ROOT / "jaxgrow/guides/any.md")

    def led(match: re.Match[str]) -> str:
        target = os.path.relpath(source.parent / match[1], ROOT)
        target = target.removeprefix("jaxgrow/guides/").removeprefix("experiments/")
        return f"]({PAGES.get(target, target)}{match[2] or ''})"

    return re.sub(r"\]\((?!\w+:|#)([^)#\s]+)(#[^)]*)?\)", led, text) if text else text


def reference() -> str:
    """The page of all public names, by folder."""
    stub = ast.parse((ROOT / "jaxgrow/__init__.pyi").read_text())
    public = dict[str, list[str]]()
    for node in stub.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [alias.asname or alias.name for alias in node.names]
            public.setdefault(node.module.split(".")[0], []).extend(names)
    if set(public) != set(TITLES):
        raise ValueError(f"TITLES and folders differ: {set(public) ^ set(TITLES)}.")
    sections = [
        f"## {title}\n\n" + "".join(f"::: jaxgrow.{n}\n\n" for n in public[folder])
        for folder, title in TITLES.items()
    ]
    opening = "All names of `import jaxgrow as jg`, with their docstrings.\n"
    return "\n".join(["# Reference\n", opening, *sections])


class PlainDocstrings(Extension):
    """Docstrings whose formulas and blocks of code are Markdown."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Write roles of reStructuredText as Markdown does."""
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)


def as_markdown(text: str) -> str:
    text = re.sub(r":math:`([^`]*)`", r"`\1`", text)
    block = re.compile(r"^\.\. (?:math|code-block)::(.*)\n((?:\n|[ ]+.*\n?)*)", re.M)
    return block.sub(lambda m: f"```\n{m[2].strip()}\n```\n\n", text)
