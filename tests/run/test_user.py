"""A user id without a name, as containers have it."""

import getpass
import os
import pwd

import pytest

from pipeline.run.user import name_the_user


@pytest.fixture
def unnamed(monkeypatch):
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.setenv(name, "")  # so that what is set below is taken back after the test

    def unknown(uid):
        raise KeyError(f"getpwuid(): uid not found: {uid}")

    monkeypatch.setattr(pwd, "getpwuid", unknown)


def test_a_user_id_without_a_name_gets_its_number(unnamed):
    with pytest.raises((KeyError, OSError)):
        getpass.getuser()
    name_the_user()
    assert getpass.getuser() == str(os.getuid())


def test_a_name_is_left_as_it_is(unnamed, monkeypatch):
    monkeypatch.setenv("USER", "ada")
    name_the_user()
    assert getpass.getuser() == "ada" and os.environ["LOGNAME"] == ""
