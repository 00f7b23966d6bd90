"""The shape of the source: which way imports point, where third-party packages live, what is documented."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "spinestiff"
MODULES = sorted(SOURCE.rglob("*.py"))

# A package may import from packages of a lower layer, never from its own layer's neighbours.
LAYERS = {
    "errors": 0,
    "normal": 0,
    "words": 0,
    "observer": 0,
    "shown": 0,
    "arrays": 1,
    "parallel": 1,
    "formats": 1,
    "files": 2,
    "anatomy": 3,
    "mechanics": 4,
    "imaging": 4,
    "estimation": 5,
    "personalise": 5,
    "interop": 5,
    "plot": 8,
    "versions": 0,
    "run_log": 6,
    "subject": 5,
    "curves": 6,
    "loopback": 6,
    "study": 7,
    "verification": 8,
    "annotate": 8,
    "cohort": 8,
    "workbench": 9,
    "app": 10,
    "__main__": 11,
}
# Where a third-party package may be imported; what is missing here may be imported nowhere.
HOMES: dict[str, tuple[str, ...]] = {
    "numpy": ("*",),
    "scipy": ("*",),
    "pydicom": ("imaging/*",),
    "PIL": ("imaging/dicom/decoding.py",),
    "jpeg_ls": ("imaging/dicom/decoding.py",),
    "openjpeg": ("imaging/dicom/decoding.py",),
    "cv2": ("imaging/*",),
    "skimage": ("imaging/*", "estimation/profiles.py"),
    "numba": ("mechanics/*", "imaging/synthetic/path_length.py", "imaging/synthetic/texture.py"),
    "rslab": ("mechanics/factor.py",),
    "threadpoolctl": ("parallel.py",),
    "matplotlib": (
        "study/report/figures.py",
        "study/report/overlay.py",
        "study/report/curve_pictures.py",
        "study/report/beside.py",
        "study/report/certainty_pictures.py",
        "study/report/clinician_picture.py",
        "study/report/cobb_picture.py",
        "study/report/frame_strip.py",
        "study/report/log_picture.py",
        "study/report/plan_picture.py",
        "study/report/repeat_picture.py",
        "study/report/tornado_picture.py",
        "study/report/pictures.py",
        "study/report/page.py",
        "anatomy/picture.py",
        "mechanics/picture.py",
        "estimation/picture.py",
        "plot.py",
        "study/report/seven_pictures.py",
        "cohort/picture.py",
    ),
    "jinja2": ("study/report/viewer/page.py",),
    "pydantic": ("subject/*", "curves/corner_files.py", "annotate/*", "cohort/*", "loopback/asking.py", "workbench/*"),
    "pydantic_core": ("subject/*",),
    "fastapi": ("annotate/server.py", "loopback/asking.py", "workbench/*"),
    "uvicorn": ("loopback/serving.py",),
    "typer": ("app/*",),
    "rich": ("app/*",),
    "trimesh": ("anatomy/*",),
    "meshio": ("anatomy/*",),
    "mmgpy": ("anatomy/mmg.py",),
    "pyfebio": ("anatomy/export/feb.py",),
    "torch": ("interop/torch.py",),
    "jax": ("interop/jax.py",),
    "distributed": ("cohort/cluster.py", "cohort/cluster_task.py"),
    "nvmath": ("mechanics/cudss.py",),
    "cuda": ("mechanics/cudss.py",),
}
# Packages of extras, and the extra: what needs one says so in one line, and interop is imported by nothing.
EXTRAS = {
    "torch": "torch",
    "jax": "jax",
    "mmgpy": "mesh",
    "pyfebio": "febio",
    "distributed": "cluster",
    "nvmath": "gpu",
    "cuda": "gpu",
}
# The distribution that holds a package, where it is named otherwise.
DISTRIBUTIONS = {
    "cv2": "opencv-python-headless",
    "skimage": "scikit-image",
    "pydantic_core": "pydantic",
    "PIL": "pillow",
    "jpeg_ls": "pyjpegls",
    "openjpeg": "pylibjpeg-openjpeg",
    "nvmath": "nvmath-python",
    "cuda": "nvmath-python",  # which brings cuda-bindings
}
NEEDS_AN_EXTRA = {"torch_equilibrium", "jax_equilibrium"}
EMPTY_NAMES = re.compile(r"manager|handler|helper|utils?\b|utilities|misc", re.IGNORECASE)
# Written so that this file does not hold what it looks for.
FOREIGN = re.compile(r"(?<![\w.])/(?:wor[k]|tm[p]|hom[e]|roo[t]|User[s])/\w|\b(?:this|developer'?s?) sessio[n]\b")
TEXT = {
    ".py",
    ".md",
    ".toml",
    ".yml",
    ".yaml",
    ".cff",
    ".j2",
    ".html",
    ".css",
    ".js",
    ".ts",
    ".json",
    ".csv",
    ".txt",
    "",
}
FOLDERS = ("src", "tests", "docs", "examples", "benchmarks", "tools", "web", ".ci", ".github")
# What tools leave behind or fetch.
LITTER = {"__pycache__", "node_modules"}


class Import(NamedTuple):
    """One imported module or name, and where."""

    target: str
    line: int


def name_of(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in MODULES}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imports(path: Path) -> Iterator[Import]:
    """Every import of a file, those inside functions and under TYPE_CHECKING included."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(alias.name, node.lineno)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno}: relative import; write the whole name"
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                target = submodule if submodule in NAMES else str(node.module)
                yield Import(target, node.lineno)


def package_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def ids(path: Path) -> str:
    return str(path.relative_to(SOURCE))


def test_every_module_lies_in_a_known_layer() -> None:
    assert len(MODULES) > 15
    unknown = {package_of(name) for name in NAMES} - set(LAYERS) - {""}
    assert not unknown, f"packages without a layer: {unknown}"


def test_imports_point_one_way() -> None:
    wrong, seen = [], 0
    for path in MODULES:
        if path == SOURCE / "__init__.py":
            continue  # the list of public names, above all layers
        own = package_of(name_of(path))
        for found in imports(path):
            if found.target.split(".")[0] != "spinestiff":
                continue
            seen += 1
            other = package_of(found.target)
            # The version is the one thing that everybody may have from the top.
            allowed = other == "" if found.target == "spinestiff" else other == own or LAYERS[other] < LAYERS[own]
            if not allowed:
                wrong.append(f"{ids(path)}:{found.line} imports {found.target}")
    assert seen > 10
    assert not wrong, "\n".join(wrong)


def test_no_result_comes_from_a_room_whose_sources_do_not_count() -> None:
    from spinestiff.subject.program import ABOVE

    rooms = {name.removesuffix(".py") for name in ABOVE}
    assert rooms <= set(LAYERS)
    wrong = [
        f"{ids(path)}:{found.line} imports {found.target}"
        for path in MODULES
        if package_of(name_of(path)) not in ("", *rooms)
        for found in imports(path)
        if found.target.startswith("spinestiff.") and package_of(found.target) in rooms
    ]
    assert not wrong, "\n".join(wrong)


def test_what_is_beside_the_results_is_imported_by_nothing_that_makes_one() -> None:
    """So that an edit there has no result made again; and all modules of words count as words."""
    from spinestiff.subject.program import ABOVE, BESIDE, TOLD

    def lies_in(path: Path, places: tuple[str, ...]) -> bool:
        inside = path.relative_to(SOURCE)
        return any(one.as_posix() in places for one in (inside, *inside.parents))

    assert all((SOURCE / name).exists() for name in BESIDE)
    found, todo = set(), ["spinestiff.study.runner", "spinestiff.study.repeatability", "spinestiff.study.phantom"]
    todo += [name for name in NAMES if name.startswith(("spinestiff.study.seven.", "spinestiff.study.planning."))]
    while todo:
        name = todo.pop()
        if name in NAMES and name not in found:
            found.add(name)
            todo += [one.target for one in imports(NAMES[name])]
    assert len(found) > 200
    assert not {ids(NAMES[name]) for name in found if lies_in(NAMES[name], BESIDE)}
    words = [path for path in MODULES if {"words", "wording"} & {path.stem, path.parent.name}]
    words = [path for path in words if not lies_in(path, ABOVE)]
    assert len(words) > 5 and not [ids(path) for path in words if not lies_in(path, TOLD)]


def test_numbers_take_nothing_but_words_from_what_only_tells_them() -> None:
    """So that an edited sentence or page can change no number, and has no result made again."""
    from spinestiff.subject.program import ABOVE, TOLD

    def lies_in(path: Path, places: tuple[str, ...]) -> bool:
        inside = path.relative_to(SOURCE)
        return any(one.as_posix() in places for one in (inside, *inside.parents))

    assert all((SOURCE / name).exists() for name in TOLD)
    told = {name for name, path in NAMES.items() if lies_in(path, TOLD)}
    wrong, words = [], 0
    for path in MODULES:
        if lies_in(path, (*ABOVE, *TOLD)):
            continue
        for node in ast.walk(tree_of(path)):
            if not isinstance(node, ast.ImportFrom):
                continue
            wrong += [
                f"{ids(path)}:{node.lineno} takes {node.module}.{one.name}"
                for one in node.names
                if f"{node.module}.{one.name}" in told
            ]
            if node.module not in told:
                continue
            # The steps write pages and pictures, too, which no later step reads.
            if path == SOURCE / "study" / "steps.py" and lies_in(NAMES[node.module], ("study/report",)):
                continue
            made = {
                one.name: ast.unparse(one.returns)
                for one in tree_of(NAMES[node.module]).body
                if isinstance(one, ast.FunctionDef) and one.returns is not None
            }
            words += len(node.names)
            wrong += [
                f"{ids(path)}:{node.lineno} takes {one.name} from {node.module}"
                for one in node.names
                if made.get(one.name) not in ("str", "list[str]")
            ]
    assert words > 20
    assert not wrong, "\n".join(wrong)


def test_only_the_version_is_imported_from_the_top() -> None:
    wrong = [
        f"{ids(path)}:{node.lineno}"
        for path in MODULES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ImportFrom)
        and node.module == "spinestiff"
        and any(alias.name != "__version__" and f"spinestiff.{alias.name}" not in NAMES for alias in node.names)
    ]
    assert not wrong, wrong


def test_third_party_packages_stay_at_home() -> None:
    wrong, seen = [], set()
    for path in MODULES:
        for found in imports(path):
            package = found.target.split(".")[0]
            if package == "spinestiff" or package in sys.stdlib_module_names:
                continue
            seen.add(package)
            if not any(is_at(path, home) for home in HOMES.get(package, ())):
                wrong.append(f"{ids(path)}:{found.line} imports {package}")
    assert "numpy" in seen
    assert not wrong, "\n".join(wrong)


def test_every_dependency_is_declared_and_used() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {re.split(r"[<>=~!; \[]", line)[0] for line in project["dependencies"]}
    packages = {found.target.split(".")[0] for path in MODULES for found in imports(path)}
    packages -= sys.stdlib_module_names | {"spinestiff"}
    assert declared == {DISTRIBUTIONS.get(package, package) for package in packages - EXTRAS.keys()}
    for package, extra in EXTRAS.items():
        assert package in packages
        listed = [re.split(r"[<>=~!; \[]", line)[0] for line in project["optional-dependencies"][extra]]
        assert DISTRIBUTIONS.get(package, package) in listed


def test_what_tools_benchmarks_and_examples_import_is_there() -> None:
    """Not all of them are run here."""
    folders = [ROOT / name for name in ("tools", "benchmarks", "examples")]
    wrong = []
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or (node.module or "").split(".")[0] != "spinestiff":
                continue
            home = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names):
                is_module = hasattr(home, "__path__") and importlib.util.find_spec(f"{node.module}.{name}") is not None
                if not hasattr(home, name) and not is_module:
                    wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}: {node.module} has no {name}")
    assert not wrong, "\n".join(wrong)


def test_nothing_imports_what_needs_an_extra() -> None:
    wrong = [
        f"{ids(path)}:{found.line} imports {found.target}"
        for path in MODULES
        if path != SOURCE / "__init__.py"  # the list of public names, each imported at its first use
        for found in imports(path)
        if found.target.startswith("spinestiff.interop")
    ]
    assert not wrong, wrong


def is_at(path: Path, home: str) -> bool:
    relative = path.relative_to(SOURCE)
    return home in ("*", relative.as_posix(), f"{relative.parts[0]}/*")


def test_no_import_cycles() -> None:
    graph = {
        name: {found.target for found in imports(path) if found.target in NAMES} - {name, "spinestiff"}
        for name, path in NAMES.items()
        if name != "spinestiff"
    }
    assert sum(map(len, graph.values())) > 10
    # Remove what imports nothing that is left, until nothing changes; a cycle is what stays.
    left = dict(graph)
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    assert not left, f"import cycle among {sorted(left)}"


def test_public_names_exist_and_are_the_typed_ones() -> None:
    top = importlib.import_module("spinestiff")
    names = set(dir(top)) - {"__version__"}
    typed = {
        (f"{node.module}", alias.name, alias.asname)
        for node in ast.walk(tree_of(SOURCE / "__init__.py"))
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "spinestiff"
        for alias in node.names
    }
    assert {name for *_, name in typed} == names
    assert 10 < len(names) < 80
    # A name that is also a room's would be the room as soon as something in it is imported.
    assert not names & set(LAYERS) - {"plot"}
    for module, own, name in typed:
        if name not in NEEDS_AN_EXTRA:
            value = importlib.import_module(f"{module}.{own}") if own == "plot" else None
            assert getattr(top, name) is (value or getattr(importlib.import_module(module), own))


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = "import sys, spinestiff; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "spinestiff" in loaded
    assert not loaded & {"numpy", "scipy", "numba", "cv2", "skimage", "pydicom", "matplotlib", "pydantic"}


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_modules_and_public_functions_are_documented(path: Path) -> None:
    tree = tree_of(path)
    if tree.body or path.name != "__init__.py":
        assert ast.get_docstring(tree), f"{ids(path)} has no docstring"
    missing = [
        f"{ids(path)}:{node.lineno} {node.name}"
        for node in tree.body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and not node.name.startswith("_")
        and not ast.get_docstring(node)
    ]
    assert not missing, "without a docstring:\n" + "\n".join(missing)


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_names_say_what_a_thing_is(path: Path) -> None:
    names = [path.stem] + [node.name for node in tree_of(path).body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    empty = [name for name in names if EMPTY_NAMES.search(name)]
    assert not empty, f"{ids(path)}: {empty}"


def test_files_name_nothing_outside_the_project() -> None:
    # In a worktree of Git, .git is a file that names another folder.
    files = [path for path in ROOT.iterdir() if path.is_file() and path.name != ".git"]
    files += [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    files = [path for path in files if path.suffix in TEXT and not LITTER & set(path.parts)]
    assert len(files) > 20
    wrong = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}"
        for path in files
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if FOREIGN.search(line)
    ]
    assert not wrong, "\n".join(wrong)
