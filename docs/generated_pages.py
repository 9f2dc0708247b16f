"""Pages of the site that are made when it is built: the README as its home, and a reference page for each folder."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
REPOSITORY_FILES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages.

    Args:
        files: those of docs/.
        config: of the site; its navigation gets a section for what is added.
    """
    files.append(File.generated(config, "index.md", content=_linked("README.md")))
    for source, page in REPOSITORY_FILES.items():
        files.append(File.generated(config, page, content=_linked(source)))
    reference = []
    for folder in sorted(path.parent for path in (ROOT / "masking").glob("*/__init__.py")):
        page = f"reference/{folder.name}.md"
        files.append(File.generated(config, page, content=_reference(folder)))
        reference.append({folder.name: page})
    if config.nav is not None:
        config.nav += [{"Modules": reference}, *REPOSITORY_FILES.values()]
    return files


def _linked(source: str) -> str:
    """Return a file of the repository's root with its links as seen from docs/."""
    text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
    for name, page in REPOSITORY_FILES.items():
        text = text.replace(f"]({name}", f"]({page}")
    return re.sub(r"`docs/(\w+)\.md`", r"[\1](\1.md)", text)


def _reference(folder: Path) -> str:
    modules = sorted(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in folder.rglob("*.py"))
    shown = [name for name in modules if not name.endswith("__init__")]
    return "\n\n".join([f"# masking.{folder.name}", *(f"::: {name}" for name in shown)]) + "\n"
