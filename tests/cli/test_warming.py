"""What is compiled ahead."""

from __future__ import annotations

import pytest

from helpers.command_line import cornercase, process


@pytest.mark.slow
def test_after_warming_up_a_demo_compiles_nothing(tmp_path):
    warmed = cornercase("warm-up")
    assert warmed.returncode == 0, warmed.stderr
    assert "compiled" in warmed.stdout
    # In this process all of it is loaded.
    demo = process("demo", "x-intersection", "--budget", "20", "-o", tmp_path)
    assert demo.returncode == 0, demo.stderr
    assert "Compiling" not in demo.stderr
