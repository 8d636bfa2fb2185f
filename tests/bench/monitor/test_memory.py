import pytest

from gyrobench.bench.monitor.memory import FolderMemory


def test_a_value_is_made_again_only_when_its_folder_has_changed(tmp_path):
    made, signs = [], {}
    memory = FolderMemory(lambda folder: made.append(folder) or len(made), signs.get, most=2)
    one, two, three = (tmp_path / name for name in "123")
    assert [memory.of(one), memory.of(one)] == [1, 1]
    signs[one] = "changed"
    assert [memory.of(one), memory.of(two), memory.of(one)] == [2, 3, 2]
    assert memory.of(three) == 4
    assert [memory.of(one), memory.of(two)] == [2, 5], "the one that was asked for longest ago has gone"


def test_an_error_is_passed_on_and_tried_again(tmp_path):
    answers = iter([ValueError("damaged"), "whole"])

    def make(_):
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    memory = FolderMemory(make, lambda _: 0, most=1)
    with pytest.raises(ValueError, match="damaged"):
        memory.of(tmp_path)
    assert memory.of(tmp_path) == "whole"
