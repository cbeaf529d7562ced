import json
from pathlib import Path

import pytest

from planspace.embed.training_log import read_log
from planspace.errors import PlanspaceError


def test_the_later_row_of_a_step_is_used_and_an_incomplete_last_line_is_ignored(tmp_path: Path) -> None:
    lines = [{"step": s, "bound": [b]} for s, b in ((500, 1.0), (1000, 2.0), (1500, 3.0), (1000, 4.0))]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (tmp_path / "log.jsonl").write_text(text + '{"step": 15')
    expected = [(500, [1.0]), (1000, [4.0]), (1500, [3.0])]
    assert [(row["step"], row["bound"]) for row in read_log(tmp_path)] == expected


def test_errors_name_the_damaged_log(tmp_path: Path) -> None:
    with pytest.raises(PlanspaceError, match=r"cannot read .*log\.jsonl"):
        read_log(tmp_path)
    (tmp_path / "log.jsonl").write_text('{"step": 1}\noops\n{"step": 2}\n')
    with pytest.raises(PlanspaceError, match=r"log\.jsonl, line 2 is damaged"):
        read_log(tmp_path)
