"""Files are there whole or not at all: whatever ends the writing, nothing half stands under the final name."""

from pathlib import Path

import pytest

from multilight.scenes.files.atomic import write_whole


def test_a_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with write_whole(path) as work:
        assert work.suffix == ".png"
        assert work.parent == tmp_path
        work.write_bytes(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("x"), KeyboardInterrupt()])
def test_an_error_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def half() -> None:
        with write_whole(path) as work:
            work.write_bytes(b"ha")
            raise error

    with pytest.raises(type(error)):
        half()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_may_write_the_same_file(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with write_whole(path) as one, write_whole(path) as other:
        assert one != other
        one.write_bytes(b"one")
        other.write_bytes(b"other")
    assert path.read_bytes() == b"one"
    assert list(tmp_path.iterdir()) == [path]


def test_folders_devices_and_missing_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, Path("/dev/null"), tmp_path / "missing" / "a"):
        with pytest.raises(OSError, match=r"replaced|No such file"), write_whole(path) as work:
            work.write_bytes(b"")
    assert Path("/dev/null").is_char_device()


def test_a_dangling_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with write_whole(tmp_path / "link") as work:
        work.write_bytes(b"here")
    assert not (tmp_path / "link").is_symlink()
    assert not (tmp_path / "nowhere").exists()
