"""Writes the files in data/, each with a header that names its script and describes its contents."""

from pathlib import Path

DATA = Path(__file__).parent / "data"


def write(name, script, columns, text, comment="//"):
    """`script`: the `__file__` of the caller. `columns`: lines about what the file holds, with units. Most files
    are expressions of Rust, whose comments begin with `//`."""
    header = [f"Made by tests/oracles/{Path(script).name}."] + columns.strip().splitlines()
    (DATA / name).write_text("".join(f"{comment} {line}\n" for line in header) + text)
