"""Where the pages are that tests read: README, guides, and the figures behind them."""

from pathlib import Path


ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "experiments" / "results"
GUIDES = ROOT / "jaxgrow" / "guides"
PAGES = [ROOT / "README.md", *sorted(GUIDES.glob("*.md"))]
LINKED = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]


def words(path: Path) -> str:
    """A page's text with every run of blanks as one."""
    return " ".join(path.read_text().split())
