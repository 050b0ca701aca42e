"""The table of rows, in Markdown."""

from typing import Any


SHOWN = {
    "residual": "residual",
    "largest_residual": "residual",
    "position_rms": "rms",
}
"""Of many errors of a contender, those that the table has, and how it calls them."""


def as_markdown(content: dict[str, Any]) -> str:
    """The rows as a table, with what they were measured on under it.

    Args:
        content: of the file of figures.
    """
    lines = [
        "| row | what | median [quartiles] | bar | reached | errors |",
        "|---|---|---|---|---|---|",
    ]
    for row in content["rows"].values():
        cells = [
            row["name"],
            row["what"],
            ratio_of(row),
            bar_of(row),
            {None: "–", True: "yes", False: "**no**"}[row["passed"]],
            errors_of(row["errors"]),
        ]
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    failures = [
        f"- **{name}** could not be measured: {why}"
        for name, why in content.get("failures", {}).items()
    ]
    gap = [""] if failures else []
    return "\n".join([*lines, *gap, *failures, "", machine_of(content)])


def ratio_of(row: dict[str, Any]) -> str:
    """Median and quartiles; how many repetitions, if there are fewer than five."""
    low, high = row["ratios"]["quartiles"]
    few = len(row["ratios"]["all"])
    number = f" ({few} only)" if few < 5 else ""
    quick = ", quick" if row.get("quick") else ""
    return f"{row['ratio']:.3g} [{low:.3g}, {high:.3g}]{number}{quick}"


def bar_of(row: dict[str, Any]) -> str:
    """What the median must be, or a dash."""
    if row["bar"] is None:
        return "–"
    return f"{'≤' if row['side'] == 'most' else '≥'} {row['bar']:g}"


def errors_of(errors: dict[str, Any]) -> str:
    """The errors in a few words: of many, those of `SHOWN`, or the largest."""
    parts = []
    for name, found in errors.items():
        about = name.replace("_", " ")
        if not isinstance(found, dict):
            parts.append(f"{about} {found:.1e}" if found else f"{about} 0")
            continue
        leaves = dict(leaves_of(found))
        shown = {SHOWN[key]: v for key, v in leaves.items() if key in SHOWN}
        if not shown:
            shown = {"at most": max(map(abs, leaves.values()))} if leaves else {}
        each = ", ".join(f"{key} {value:.1e}" for key, value in shown.items())
        parts.append(f"{about}: {each}")
    return "; ".join(parts) or "–"


def leaves_of(errors: dict[str, Any]) -> list[tuple[str, float]]:
    """Names and values at the ends of nested entries.

    Where the same name comes twice, the outermost counts.
    """
    inner, outer = [], []
    for name, found in errors.items():
        if isinstance(found, dict):
            inner += leaves_of(found)
        elif isinstance(found, int | float):
            outer.append((name, float(found)))
    return inner + outer


def machine_of(content: dict[str, Any]) -> str:
    """What the rows were measured on."""
    versions = ", ".join(f"{name} {v}" for name, v in content["versions"].items() if v)
    return (
        f"{content['processor']}, {content['processors']} processors; "
        f"{content['device']} ({content['backend']}), "
        f"{content['threads_of_xla']} threads of XLA; {versions}."
    )
