"""Runs docs/python.md as one program. Parts that need a board have one if TESAKI_SIM names host-sim."""

import re
from pathlib import Path

import pytest
import tesaki
from test_board import PROGRAM, Served

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"


def test_the_page_runs(tmp_path, monkeypatch):
    page = PAGE.read_text()
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"(<!-- board -->\n)?```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) >= 10
    names = {}
    served = Served(tmp_path / "board.sock", "hand3") if PROGRAM else None
    try:
        for needs_board, block in blocks:
            if needs_board and served is None:
                continue
            if needs_board:
                block = block.replace("tesaki.Board()", f"tesaki.Board({served.port!r})")
            line = page[: page.index(block.splitlines()[-1])].count("\n") + 1
            try:
                exec(compile(block, f"docs/python.md, before line {line}", "exec"), names)
            except Exception as error:
                pytest.fail(f"docs/python.md, before line {line}: {error!r}\n{block}")
    finally:
        if served is not None:
            served.end()


def test_the_page_names_what_there_is():
    page = PAGE.read_text()
    for method in re.findall(r"board\.(\w+)\(", page):
        assert hasattr(tesaki.Board, method), method
    for method in re.findall(r"(?:arm|hand)\.(\w+)\(", page):
        assert hasattr(tesaki.Robot, method), method
