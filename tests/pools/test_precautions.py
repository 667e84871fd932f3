"""The folder for Ray's sockets and logs is this user's alone, and short."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from pfdist.errors import PoolError
from pfdist.pools.ray_cluster import private_folder

LONGEST = "/session_2026-11-20_12-46-57_059075_4194304/sockets/plasma_store"


@pytest.fixture
def place(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the folder is to lie: the path of the temporary folder of a test may be too long."""
    monkeypatch.setattr("pfdist.pools.ray_cluster.LONGEST_FOLDER", 1000)
    folder = tmp_path_factory.mktemp("r")
    monkeypatch.setenv("RAY_TMPDIR", str(folder))
    return folder / f"pfdist-ray-{os.getuid()}"


def test_nobody_else_can_enter_the_folder_that_holds_rays(place: Path) -> None:
    mask = os.umask(0)
    try:
        assert private_folder() == str(place / "r")
    finally:
        os.umask(mask)
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    assert private_folder() == str(place / "r")  # it is there already


def _link(place: Path) -> None:
    (place.parent / "elsewhere").mkdir(0o700)
    place.symlink_to("elsewhere")


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        pytest.param(_link, "is a link", id="a-link-to-a-folder"),
        pytest.param(lambda place: place.symlink_to("nowhere"), "is a link", id="a-dangling-link"),
        pytest.param(Path.touch, "is no folder", id="a-file"),
        pytest.param(os.mkfifo, "is no folder", id="a-fifo"),
        pytest.param(lambda place: place.mkdir() or place.chmod(0o777), "mode 777", id="for-all"),
        pytest.param(lambda place: place.mkdir() or place.chmod(0o710), "mode 710", id="for-group"),
    ],
)
def test_what_others_may_have_put_there_is_refused_in_one_line(
    plant: Callable[[Path], object], words: str, place: Path
) -> None:
    plant(place)
    with pytest.raises(PoolError, match=words) as caught:
        private_folder()
    assert "\n" not in str(caught.value)
    assert str(place) in str(caught.value)
    assert "RAY_TMPDIR" in str(caught.value)


def test_a_folder_of_another_user_is_refused(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, other = os.getuid(), os.getuid() + 1
    place.with_name(f"pfdist-ray-{other}").mkdir(0o700)
    monkeypatch.setattr(os, "getuid", lambda: other)
    with pytest.raises(PoolError, match=f"is a folder of user {owner}"):
        private_folder()


@pytest.mark.parametrize("place_length", [4, 15, 120])
def test_the_paths_of_rays_sockets_are_short(
    place_length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "mkdir", lambda *_, **__: None)
    monkeypatch.setattr(
        Path, "lstat", lambda _: os.stat_result((0o40700, *[0] * 3, os.getuid(), *[0] * 5))
    )
    monkeypatch.setenv("RAY_TMPDIR", "/" + "a" * (place_length - 1))
    assert len(private_folder() + LONGEST) <= 107
