"""Build hook: adds the modules of ogm_core that ogm_client imports, found by following its imports."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CORE = "ogm_core"


class CoreModules(BuildHookInterface):
    """Adds them to the wheel and to the source distribution."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files before the build; an editable install leads to the sources as they are."""
        if version == "editable":
            return
        clients = Path(self.root)
        # A source distribution holds the core inside, a checkout beside this folder.
        home = clients if (clients / CORE).is_dir() else clients.parent
        files = core_files(home, (clients / "ogm_client").rglob("*.py"))
        build_data["force_include"].update({str(file): str(file.relative_to(home)) for file in files})


def core_files(home: Path, importers: Iterator[Path]) -> set[Path]:
    """Files below home/ogm_core that the importers import, directly or not, and the mark that it is typed."""
    files: set[Path] = set()
    waiting = list(importers)
    while waiting:
        fresh = {file for name in imported(waiting.pop()) for file in loaded(home, name)} - files
        files |= fresh
        waiting += fresh
    return files | {home / CORE / "py.typed"}


def imported(file: Path) -> Iterator[str]:
    """Full names that a module imports, anywhere in it; some name a class or a function, not a module."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def loaded(home: Path, name: str) -> Iterator[Path]:
    """Files that importing `name` runs, if it is one of the core's: its packages, and itself."""
    parts = name.split(".")
    if parts[0] != CORE:
        return
    for length in range(1, len(parts) + 1):
        module = home.joinpath(*parts[:length])
        yield from filter(Path.is_file, (module / "__init__.py", module.with_suffix(".py")))
