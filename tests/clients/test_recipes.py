"""The recipes of the documents, run to the letter: recipes.py says how a page is read.

Each section of a page is a test, in a network namespace of its own: so nothing leaves the machine,
and a fixed port is free. `make install` is run as the page says, but into a directory of the test;
the other recipes find the programs that the tests use as `sim`, `bridge` and `node-update`.
"""

import os
import pathlib
import re
import subprocess
import sys

import pytest

import recipes
from conftest import ROOT, namespace, project_program

PAGES = {
    name: recipes.read_page(ROOT / "docs" / f"{name}.md")
    for name in (
        "autopilots",
        "bench",
        "bridge",
        "own-node",
        "sketch",
        "update",
        "utilisation",
    )
}
MARKS = {
    "quick": [pytest.mark.timeout(1820)],
    "long": [pytest.mark.long, pytest.mark.timeout(3620)],
}
TIMEOUT_S = {"quick": 1800, "long": 3600}
CASES = [
    pytest.param(
        name,
        title,
        mode,
        id="-".join([name, *re.findall(r"\w+", title), *([] if mode == "quick" else [mode])]),
        marks=MARKS[mode],
    )
    for name, page in PAGES.items()
    for title in page.sections
    for mode in page.modes(title)
]


def environment(directory):
    """The environment of a user who has run `make install`."""
    installed, programs = directory / "installed", directory / "programs"
    programs.mkdir()
    for name in ("sim", "bridge", "node-update"):
        (programs / name).symlink_to(project_program(name))
    home = pathlib.Path.home()
    return {
        **{
            name: value
            for name, value in os.environ.items()
            if name not in ("NODE_ELF", "NODE_BOARD", "NODE_SHIELD", "MAVLINK20")
        },
        "CARGO_HOME": os.environ.get("CARGO_HOME", str(home / ".cargo")),
        "RUSTUP_HOME": os.environ.get("RUSTUP_HOME", str(home / ".rustup")),
        "CARGO_INSTALL_ROOT": str(installed),
        "CARGO_TERM_COLOR": "never",
        # The namespace has no network.
        "CARGO_NET_OFFLINE": "true",
        "RECIPES_PATH": os.pathsep.join(
            [str(installed / "bin"), str(programs), os.environ["PATH"]]
        ),
        "PYTHONUNBUFFERED": "1",
    }


@pytest.mark.parametrize(("name", "title", "mode"), CASES)
def test_the_recipes_of_a_section_do_what_the_page_says(name, title, mode, tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    as_root = [
        block.text
        for block in PAGES[name].sections[title]
        if "as root" in block.kinds and block.runs(mode)
    ]
    line = [
        *namespace("\n".join(["ip link set lo up", *as_root])),
        sys.executable,
        recipes.__file__,
    ]
    done = subprocess.run(
        [*line, ROOT / "docs" / f"{name}.md", title, mode, home],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(tmp_path),
        timeout=TIMEOUT_S[mode],
    )
    print(done.stdout)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", PAGES)
def test_commands_are_in_blocks_and_need_no_sudo_and_no_fixed_file(name):
    page = PAGES[name]
    blocks = [block.prelude + block.text for section in page.sections.values() for block in section]
    assert blocks
    for text in blocks:
        assert "sudo" not in text and "/tmp" not in text, text
    assert not re.findall(
        r"^    (?:sim|bridge|node-update|make|cargo) .*",
        (ROOT / "docs" / f"{name}.md").read_text(),
        re.M,
    )


def test_a_page_is_read_according_to_its_comments(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(
        "## One\n\nTerminal 1:\n\n```sh\nserve\n```\n\nIn Terminal 2:\n\n<!-- recipe: long -->\n"
        "```sh\nask\n```\n\n"
        "<!-- output: numbers vary -->\n```text\ntook 1.5 s ... OK\n```\n## Two\n\n<!-- recipe: "
        "needs a screen -->\n```sh\nlook\n```\n"
    )
    page = recipes.read_page(path)
    serve, ask = page.sections["One"]
    assert (serve.terminal, serve.text, ask.terminal, ask.kinds) == (1, "serve\n", 2, {"long"})
    assert page.modes("One") == ["quick", "long"] and page.modes("Two") == []
    [(lines, numbers_vary)] = ask.outputs
    expression = recipes.pattern(lines, numbers_vary)
    assert expression.search("before\ntook 12 s or so: OK\nafter\n")
    assert not expression.search("took 12 s: NO\n") and not expression.search("took long s: OK\n")


def test_output_is_compared_line_by_line():
    assert recipes.pattern(["a", "...", "b"], False).search("a\nx\ny\nb\n")
    assert recipes.pattern(["a", "...", "b"], False).search("a\nb\n")
    assert not recipes.pattern(["a", "b"], False).search("a\nx\nb\n")
    assert not recipes.pattern(["1"], False).search("2\n")
    assert recipes.pattern(["     1.0 x2 id 7"], True).search("   22.13 x2 id 8\n")
