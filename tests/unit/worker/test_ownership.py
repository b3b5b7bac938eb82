"""Folders that other users of the machine must not read or change: closed, or refused."""

import os
from pathlib import Path

import pytest

from worker.ownership import NotOurs, check_unshared, make_private

NOBODY = 65534
ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a file in a folder in it, which this user alone can enter and write to."""
    (tmp_path / "ours" / "inner").mkdir(parents=True)
    (tmp_path / "ours" / "inner" / "file").touch()
    for path in (tmp_path / "ours", *tmp_path.glob("ours/**/*")):
        path.chmod(0o700)
    return tmp_path / "ours"


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o7777


def test_a_folder_that_is_missing_is_made_for_this_user_alone(tmp_path: Path, caplog):
    umask = os.umask(0)
    try:
        make_private(tmp_path / "deep" / "data")
    finally:
        os.umask(umask)
    assert mode(tmp_path / "deep" / "data") == 0o700
    make_private(tmp_path / "deep" / "data")
    assert caplog.messages == []


@pytest.mark.parametrize("before", [0o755, 0o701, 0o710, 0o777, 0o1770])
def test_a_folder_that_is_open_is_closed_with_a_warning(folder: Path, caplog, before: int):
    folder.chmod(before)
    make_private(folder)
    assert mode(folder) == before & ~0o077
    assert caplog.messages == [
        f"{folder} was open to other users of this machine (mode {before:04o}); it is closed now"
    ]


def test_a_folder_that_all_users_share_is_refused_as_it_is(folder: Path, monkeypatch):
    for before, inner, root in ((0o1777, 0o700, Path("/")), (0o755, 0o755, folder.parent)):  # /tmp, /usr
        monkeypatch.setattr("worker.ownership._ROOT", root)
        folder.chmod(before)
        (folder / "inner").chmod(inner)
        with pytest.raises(NotOurs, match=f"^{folder} is shared by all users"):
            make_private(folder)
        assert mode(folder) == before
    (folder / "inner").rename(folder / "stores")  # whose service was not private
    make_private(folder)
    assert mode(folder) == 0o700


@ROOT_ONLY
def test_a_folder_of_another_user_is_not_made_private(folder: Path):
    os.chown(folder, NOBODY, NOBODY)
    with pytest.raises(NotOurs, match=f"^{folder} belongs to another user"):
        make_private(folder)


@ROOT_ONLY
@pytest.mark.parametrize(("before", "refused"), [(0o775, True), (0o757, True), (0o755, False)])
def test_a_folder_into_which_others_could_write_must_hold_nothing_of_theirs(
    folder: Path, before: int, refused: bool
):
    """Where they could not, what is theirs was put there by this user."""
    os.chown(folder / "inner", NOBODY, NOBODY)
    folder.chmod(before)
    if refused:
        with pytest.raises(NotOurs, match=f"^{folder / 'inner'} belongs to another user, who could write"):
            make_private(folder)
    else:
        make_private(folder)
    assert mode(folder) == 0o700


@pytest.mark.parametrize("opened", ["", "inner", "inner/file"])
@pytest.mark.parametrize("by", [0o020, 0o002])
def test_what_others_can_reach_they_must_not_be_able_to_write_to(folder: Path, opened: str, by: int):
    for path in (folder, folder / "inner"):
        path.chmod(0o755)
    (folder / "inner" / "file").chmod(0o644)
    check_unshared(folder)
    path = folder / opened
    path.chmod(mode(path) | by)
    with pytest.raises(NotOurs, match=f"^{path} can be written by other users .mode {mode(path):04o}.$"):
        check_unshared(folder)


@pytest.mark.parametrize("closed", ["", "inner"])
def test_behind_a_folder_that_others_cannot_enter_permissions_do_not_matter(folder: Path, closed: str):
    """Also where only a folder in it is closed."""
    folder.chmod(0o755 if closed else 0o700)
    (folder / "inner" / "file").chmod(0o666)
    if not closed:
        (folder / "inner").chmod(0o777)
    check_unshared(folder)


@ROOT_ONLY
@pytest.mark.parametrize("given", ["", "inner", "inner/file"])
def test_what_others_own_is_refused_wherever_it_is(folder: Path, given: str):
    os.chown(folder / given, NOBODY, NOBODY)
    with pytest.raises(NotOurs, match=f"^{folder / given} belongs to another user$"):
        check_unshared(folder)


@pytest.mark.parametrize("place", ["link", "inner/link"])
def test_a_link_is_refused(folder: Path, place: str):
    (folder / place).symlink_to(folder.parent)
    with pytest.raises(NotOurs, match=f"^{folder / place} is a link"):
        check_unshared(folder)


def test_a_folder_that_others_could_replace_is_refused(folder: Path):
    """Not where each may only remove what is his own, as in /tmp; nor where nothing is yet."""
    folder.parent.chmod(0o777)
    with pytest.raises(NotOurs, match=f"^{folder.parent} can be written by every user"):
        check_unshared(folder)
    check_unshared(folder / "nothing")
    folder.parent.chmod(0o1777)
    check_unshared(folder)
