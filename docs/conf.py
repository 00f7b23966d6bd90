"""The documentation site: ``sphinx-build -W docs build/site`` (CONTRIBUTING.md)."""

from __future__ import annotations

import pkgutil
import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective
from typer.main import get_group

import spinestiff
from spinestiff.app.cli import app as command_line

project = "spinestiff"
author = "The spinestiff contributors"
release = version = spinestiff.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_copybutton"]
exclude_patterns = ["**.ipynb_checkpoints"]

# Pages are Markdown that code hosts show, too; headings of up to four levels can be linked to.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# Notebooks are stored without outputs and run by each build; a cell that fails ends the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"spinestiff {release}"
html_static_path = ["_static", str(files("ziamath") / "fonts" / "STIXTwoMath-Regular.ttf")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
html_math_renderer = "mathml"
html_theme_options = {
    "announcement": "Research software. Not for diagnosis, treatment decisions or brace prescription.",
}
highlight_language = "none"

ROOMS = "|".join(package.name for package in pkgutil.iter_modules(spinestiff.__path__) if package.ispkg)
BAR = re.compile(r"(``.*?``)|\|")  # of an absolute value; not inside code
SECTION_ENTRY = re.compile(r"(\w+(?:, \w+)*) : (.+)")


def as_restructured_text(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """A docstring as Sphinx reads it: sections as lists, indented equations as they stand."""
    lines[:] = [
        line if line.startswith("    ") else BAR.sub(lambda found: found[1] or r"\|", line) for line in rewritten(lines)
    ]


def rewritten(lines: Sequence[str]) -> Iterator[str]:
    """Lines of a docstring with underlined sections of ``name : text`` as bullets, and equations as literal blocks."""
    section, literal, before = False, False, ""
    for line, after in zip(lines, [*lines[1:], ""]):
        if len(line) > 2 and set(line) == {"-"}:
            continue
        indented = line.startswith("    ")
        if len(after) > 2 and set(after) == {"-"}:
            section = True
            yield from ("", f"**{line}**", "")
        elif section and (entry := SECTION_ENTRY.fullmatch(line)):
            yield f"* **{entry[1]}** – {entry[2]}"
        elif section and (indented or not line):
            yield line[2:]
        else:
            if section:
                yield ""
            section = False
            if indented and not literal and not before:
                yield from ("::", "")
            literal = indented or (literal and not line)
            yield line
        before = line


def is_no_text(app: Sphinx, what: str, name: str, thing: object, skip: bool, options: object) -> bool | None:
    """Fields of named tuples bring a sentence of Python's own, which says nothing."""
    return True if str(getattr(thing, "__doc__", "")).startswith("Alias for field number") else None


def api_name(text: str) -> str | None:
    """The name under which the API reference has what ``text`` names: public names lie at the top."""
    name = re.sub(rf"^(?:ss\.|(?=(?:{ROOMS})\.))", "spinestiff.", text)
    if not re.fullmatch(r"spinestiff(\.\w+)+", name):
        return None
    for public, home in spinestiff._HOMES.items():
        if name == f"{home}.{public}" or name.startswith(f"{home}.{public}."):
            return f"spinestiff.{name.removeprefix(home + '.')}"
    return name


class NamesAsLinks(SphinxTransform):
    """A dotted name in the text, as ``ss.rib_push``, links to its entry in the API reference where it has one."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        for literal in list(self.document.findall(nodes.literal)):
            name = api_name(literal.astext())
            if name is None or isinstance(literal.parent, nodes.reference | pending_xref):
                continue
            target = {"refdomain": "py", "reftype": "obj", "reftarget": name, "refdoc": self.env.docname}
            link = pending_xref("", refexplicit=True, refwarn=False, **target)
            literal.replace_self(link)
            link += literal


class Commands(SphinxDirective):
    """Every command with its arguments and options, as the program itself describes them."""

    def run(self) -> list[nodes.Node]:
        text = "\n".join(command_text("spinestiff", get_group(command_line)))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def command_text(words: str, command: Any) -> Iterator[str]:
    """Markdown of a command, or of all commands of a group."""
    for name, one in sorted(getattr(command, "commands", {}).items()):
        yield from command_text(f"{words} {name}", one)
    if hasattr(command, "commands"):
        return
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    usage = " ".join([words, *(parameter.name.upper() for parameter in arguments), "[OPTIONS]"])
    yield from (f"## {words.removeprefix('spinestiff ')}", "", linked(command.help), "", "```sh", usage, "```", "")
    if command.params:
        yield from ("| argument or option | default | meaning |", "|---|---|---|")
    for parameter in command.params:
        name = parameter.name.upper() if parameter in arguments else ", ".join(parameter.opts)
        default = "" if parameter.default in (None, False) or callable(parameter.default) else f"{parameter.default}"
        meaning = linked(parameter.help or "") + (" *Needed.*" if parameter.required else "")
        yield f"| `{name}` | {default} | {meaning} |"
    yield ""


def linked(text: str) -> str:
    """Help on a terminal names pages by their files."""
    return re.sub(r"docs/([\w-]+)\.md", r"[\1](\1.md)", text).replace("|", "\\|").replace("\n", " ")


def as_mathml(translator: Any, node: nodes.Element, display: str) -> None:
    """Equations as MathML, which browsers draw themselves: no script, no other host."""
    mathml = convert(node.astext(), display=display)
    if "\\" in mathml:
        raise ExtensionError(f"equation that latex2mathml does not know: {node.astext()}")
    translator.body.append(mathml)
    raise nodes.SkipNode


def inline_mathml(translator: Any, node: nodes.Element) -> None:
    as_mathml(translator, node, "inline")


def block_mathml(translator: Any, node: nodes.Element) -> None:
    as_mathml(translator, node, "block")


def setup(app: Sphinx) -> dict[str, bool]:
    """What this site adds to Sphinx."""
    app.add_directive("commands", Commands)
    app.add_transform(NamesAsLinks)
    app.connect("autodoc-process-docstring", as_restructured_text)
    app.connect("autodoc-skip-member", is_no_text)
    app.add_html_math_renderer("mathml", (inline_mathml, None), (block_mathml, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
