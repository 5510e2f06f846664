"""The compilation cache uses the user's cache folder, a given folder, or none."""

import os

import jax
import pytest

from htcp_jax.caching import cache_folder


@pytest.fixture(autouse=True)
def no_cache_yet(monkeypatch):
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.delenv("HTCP_CACHE", raising=False)
    yield
    jax.config.update("jax_compilation_cache_dir", before)


def test_off_keeps_nothing(monkeypatch):
    monkeypatch.setenv("HTCP_CACHE", "off")
    assert cache_folder.enable() is None and jax.config.jax_compilation_cache_dir is None


def test_a_folder_is_made_where_the_variable_says(monkeypatch, tmp_path):
    monkeypatch.setenv("HTCP_CACHE", str(tmp_path / "a" / "b"))
    assert cache_folder.enable() == tmp_path / "a" / "b"
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "a" / "b") and (tmp_path / "a" / "b").is_dir()


def test_a_folder_chosen_through_jax_stays(tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    assert cache_folder.enable() == tmp_path


def test_a_folder_that_cannot_be_made_is_a_warning(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HTCP_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="compiled programs are not cached"):
        assert cache_folder.enable() is None


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="folders have no owner here")
def test_a_folder_of_another_user_is_a_warning(monkeypatch, tmp_path):
    monkeypatch.setenv("HTCP_CACHE", str(tmp_path))
    tmp_path.chmod(0o755)
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(tmp_path).st_uid + 1)
    with pytest.warns(UserWarning, match="belongs to another user.*compiled programs are not cached"):
        assert cache_folder.enable() is None and cache_folder.folder() is None


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="this user can write everywhere")
def test_a_folder_that_cannot_be_written_is_a_warning(monkeypatch, tmp_path):
    monkeypatch.setenv("HTCP_CACHE", str(tmp_path))
    tmp_path.chmod(0o500)
    with pytest.warns(UserWarning, match="permission denied.*compiled programs are not cached"):
        assert cache_folder.enable() is None and cache_folder.folder() is None
