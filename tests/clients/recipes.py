"""Reads the recipes of a page of docs/ and runs those of one section exactly as written.
test_recipes.py runs each section as a test.

A recipe is a fenced block of `sh`. A section is the text between two headings `## `. Its blocks run
one after the other, from the root of the repository, in an empty home directory. What the reader of
the page sees decides how a block runs:

    Terminal 1:         as the last line before the block: it runs beside the blocks of the
                        terminals with higher numbers that follow, until the last of them has ended;
                        then it gets Ctrl-C. The next terminal begins when the first line of its
                        output block has been printed, or any line if it has none.
    ```text             the next block after it is output that the block must print: these lines,
                        with nothing between them. `...` in a line is any text, a line of its own is
                        any lines.

HTML comments before a block have what the reader does not need to see. Commas separate several
words:
    <!-- recipe: in each terminal -->   begins every terminal from here to the end of the page
    <!-- recipe: as root -->            is run as root, before all other blocks of the section
    <!-- recipe: long -->               only "make test-all" runs it
    <!-- recipe: until Ctrl-C -->       ends by Ctrl-C, after its output has been printed
    <!-- recipe: exit code 1 -->        ends with this exit code
    <!-- recipe: needs a screen -->     is not run; so are "needs the network" and "needs hardware"
    <!-- typed -->                      typed into the block before, a line whenever that prints
                                        nothing for a second; then Ctrl-D. `typed after: TEXT` waits
                                        until that has printed TEXT
    <!-- output: numbers vary -->       for a block of output: any other number is as good as the
                                        one in the page
"""

import dataclasses
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
NOT_RUN = {"needs a screen", "needs the network", "needs hardware"}
KINDS = NOT_RUN | {"in each terminal", "as root", "long", "until Ctrl-C", "exit code 1"}
TIMEOUT_S = 120
# cargo waits while other parts of "make test" compile.
TIMEOUT_OF_BUILD_S = 900
TIMEOUT_OF_LONG_S = 2400
BUILDS = r"^make |cargo run |/scripts/firmware "
# A program must end within this time after Ctrl-C.
TIMEOUT_OF_END_S = 15


@dataclasses.dataclass
class Block:
    line: int
    kinds: set
    terminal: int
    # The commands that begin each terminal.
    prelude: str
    text: str
    # Lists of expected lines, each with whether numbers may vary.
    outputs: list = dataclasses.field(default_factory=list)
    typed: list = dataclasses.field(default_factory=list)
    typed_after: str = ""

    def runs(self, mode):
        """True if this block runs in `mode`: "quick", or "long", which also runs the quick ones."""
        return not self.kinds & (NOT_RUN | {"long"} - {mode})


@dataclasses.dataclass
class Page:
    # Blocks by the title of their section, in order.
    sections: dict

    def modes(self, title):
        """The modes in which the section has a block to run that no other mode runs."""
        blocks = self.sections[title]
        return [
            mode
            for mode in ("quick", "long")
            if any(
                block.runs(mode)
                and (mode == "quick" or mode in block.kinds)
                and "as root" not in block.kinds
                for block in blocks
            )
        ]


def read_page(path):
    page, prelude = Page({}), ""
    title, kinds, typed, numbers_vary, terminal = "", set(), False, False, 0
    blocks, fence, lines, start, typed_after = [], None, [], 0, ""
    for number, line in enumerate(path.read_text().splitlines(), 1):
        where = f"{path}:{number}"
        if fence is not None:
            if line != "```":
                lines.append(line)
                continue
            if fence == "sh":
                block = Block(start, kinds, terminal, prelude, "\n".join(lines) + "\n")
                if "in each terminal" in kinds:
                    prelude += block.text
                else:
                    blocks.append(block)
            elif typed:
                assert blocks, f"{where}: nothing to type this into"
                blocks[-1].typed, blocks[-1].typed_after = lines, typed_after
            elif fence == "text" and blocks:
                blocks[-1].outputs.append((lines, numbers_vary))
            fence, kinds, typed, numbers_vary, terminal = None, set(), False, False, 0
        elif match := re.fullmatch(r"<!-- recipe: (.*) -->", line):
            kinds = {kind.strip() for kind in match[1].split(",")}
            assert kinds <= KINDS, f"{where}: {kinds - KINDS} is no kind of recipe"
        elif match := re.fullmatch(r"<!-- typed(?: after: (.*))? -->", line):
            typed, typed_after = True, match[1] or ""
        elif line == "<!-- output: numbers vary -->":
            numbers_vary = True
        elif match := re.fullmatch(r"```(.*)", line):
            fence, lines, start = match[1], [], number
        elif line.startswith("## "):
            title, blocks = line[3:], []
            page.sections[title] = blocks
        elif match := re.fullmatch(r"(?:.* )?Terminal (\d)\b[^.]*:", line):
            terminal = int(match[1])
        elif line:
            terminal = 0
    assert fence is None, f"{path}: a block is open at the end"
    return page


# A number with the spaces before it. A longer number has fewer.
NUMBER = re.compile(r"( *)(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?!\w)")


def pattern(lines, numbers_vary):
    """A regular expression for the output that a page promises."""

    def escape(text):
        if not numbers_vary:
            return re.escape(text)
        done, at = "", 0
        for number in NUMBER.finditer(text):
            done += (
                re.escape(text[at : number.start()])
                + (" *" if number[1] else "")
                + r"[-+]?\d[\d,]*(?:\.\d+)?"
            )
            at = number.end()
        return done + re.escape(text[at:])

    expression = "(?m)^"
    for line in lines:
        if line == "...":
            expression += r"(?:.*\n)*?"
        else:
            expression += (
                ".*".join(escape(part) for part in line.rstrip().split("...")) + r"[ \r]*\n"
            )
    return re.compile(expression)


class Failure(Exception):
    pass


class Running:
    """A block that runs in its own bash, with its output."""

    def __init__(self, block, home, environment):
        self.block = block
        self.output = tempfile.TemporaryFile()
        # Exactly as written, except that the target directory may be elsewhere and that each line
        # must succeed.
        text = (block.prelude + block.text).replace('"$repository"/target/', f"{TARGET}/")
        self.process = subprocess.Popen(
            ["bash", "-c", "set -e -o pipefail\n" + text],
            # ravedude reads a closed input over and over, which takes a processor.
            stdin=subprocess.PIPE
            if block.typed or "until Ctrl-C" in block.kinds
            else subprocess.DEVNULL,
            stdout=self.output,
            stderr=subprocess.STDOUT,
            cwd=ROOT,
            env={**environment, "HOME": str(home)},
            start_new_session=True,
        )
        self.timeout_s = (
            TIMEOUT_OF_LONG_S
            if "long" in block.kinds
            else TIMEOUT_OF_BUILD_S
            if re.search(BUILDS, block.text, re.MULTILINE)
            else TIMEOUT_S
        )
        if block.typed:
            threading.Thread(target=self.type, daemon=True).start()

    def text(self):
        size = os.fstat(self.output.fileno()).st_size
        return os.pread(self.output.fileno(), size, 0).decode(errors="replace")

    def is_over(self):
        return self.process.poll() is not None

    def type(self):
        """Types a line after each second without output, at most ten seconds after the last line.
        """
        end = time.monotonic() + self.timeout_s
        while (
            self.block.typed_after not in self.text()
            and not self.is_over()
            and time.monotonic() < end
        ):
            time.sleep(0.05)
        for line in self.block.typed:
            size, quiet_since, latest = 0, time.monotonic(), time.monotonic() + 10
            while time.monotonic() < min(quiet_since + 1, latest) and not self.is_over():
                if len(self.text()) != size:
                    size, quiet_since = len(self.text()), time.monotonic()
                time.sleep(0.05)
            try:
                self.process.stdin.write(f"{line}\n".encode())
                self.process.stdin.flush()
            except BrokenPipeError:
                return
        self.process.stdin.close()

    def wait_for(self, expression):
        end = time.monotonic() + self.timeout_s
        while not expression.search(self.text()):
            if self.is_over():
                raise Failure(f"the program ended before it printed {expression.pattern!r}")
            if time.monotonic() > end:
                raise Failure(
                    f"the program did not print {expression.pattern!r} within {self.timeout_s} s"
                )
            time.sleep(0.05)

    def wait_until_ready(self):
        if self.block.outputs:
            lines, numbers_vary = self.block.outputs[0]
            self.wait_for(pattern(lines[:1], numbers_vary))
        else:
            self.wait_for(re.compile(r".*\n"))

    def interrupt(self):
        """Sends Ctrl-C."""
        if self.is_over():
            raise Failure(f"the program ended by itself, with exit code {self.process.returncode}")
        os.killpg(self.process.pid, signal.SIGINT)
        also = []
        if re.search(BUILDS, self.block.text, re.MULTILINE):
            also = [-signal.SIGINT, 128 + signal.SIGINT]
            # make waits for its program a second time if that ended before make took the signal.
            if self.wait(TIMEOUT_OF_END_S) == 2 and "wait: No child processes" in self.text():
                also.append(2)
        self.finish(TIMEOUT_OF_END_S, also)

    def wait(self, timeout_s):
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise Failure(f"the program did not end within {timeout_s} s") from None

    def finish(self, timeout_s, also=()):
        code = self.wait(timeout_s)
        if code != (1 if "exit code 1" in self.block.kinds else 0) and code not in also:
            raise Failure(f"exit code {code}")
        for lines, numbers_vary in self.block.outputs:
            if not pattern(lines, numbers_vary).search(self.text()):
                raise Failure("the output lacks these lines of the page:\n" + "\n".join(lines))

    def kill(self):
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait()


def run_section(page, title, mode, home, environment):
    """Runs the blocks of a section in order. Raises `Failure` at the first that does not do what
    the page says.
    """
    background = []
    running = None

    def end_background():
        nonlocal running
        while background:
            running = background.pop()
            try:
                running.interrupt()
            finally:
                running.kill()

    blocks = [
        block for block in page.sections[title] if block.runs(mode) and "as root" not in block.kinds
    ]
    try:
        for index, block in enumerate(blocks):
            if block.terminal <= 1:
                end_background()
            started = time.monotonic()
            running = Running(block, home, environment)
            if (
                block.terminal
                and index + 1 < len(blocks)
                and blocks[index + 1].terminal > block.terminal
            ):
                background.append(running)
                running.wait_until_ready()
                continue
            try:
                if "until Ctrl-C" in block.kinds:
                    for lines, numbers_vary in block.outputs:
                        running.wait_for(pattern(lines, numbers_vary))
                    running.interrupt()
                else:
                    running.finish(running.timeout_s)
            finally:
                running.kill()
            print(f"line {block.line}: {time.monotonic() - started:.1f} s")
        end_background()
    except Failure as failure:
        shown = "".join(
            f"--- line {one.block.line}\n{one.text()[-6000:]}" for one in [*background, running]
        )
        raise Failure(
            f"line {running.block.line}, {running.block.text.splitlines()[0]}: {failure}\n{shown}"
        ) from None
    finally:
        for one in background:
            one.kill()


def main():
    """Runs one section: PAGE TITLE MODE HOME, with this environment except HOME."""
    path, title, mode, home = sys.argv[1:]
    # In a script's background process SIGINT is ignored, and the programs that start from here
    # would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    environment = dict(os.environ)
    # sudo does not pass PATH on.
    environment["PATH"] = environment.pop("RECIPES_PATH", environment["PATH"])
    try:
        run_section(read_page(pathlib.Path(path)), title, mode, pathlib.Path(home), environment)
    except Failure as failure:
        sys.exit(f"{path}: {failure}")


if __name__ == "__main__":
    main()
