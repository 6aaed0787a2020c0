from __future__ import annotations

from typing import Any

import pytest
import yaml

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.secrets import (
    completed,
    is_secret,
    public_setting,
    public_settings,
    public_text,
    secret_values,
    usable,
)

WORD = "hunter2"
USER = {"transport": {"auth": {"usrpwd": {"user": "me", "password": WORD, "dictionary_file": "/etc/words"}}}}
TEXT = '{transport: {auth: {usrpwd: {user: "me", password: "hunter2", dictionary_file: "/etc/words"}}}}'


@pytest.mark.parametrize(
    ("name", "secret"),
    [
        ("password", True),
        ("private_key_pem", True),
        ("listen_private_key_base64", True),
        ("auth_token", True),
        ("password_file", False),
        ("dictionary_file", False),
        ("connect_private_key", False),  # a path
        ("user", False),
        ("endpoints", False),
    ],
)
def test_which_fields_are_secret(name: str, secret: bool) -> None:
    assert is_secret(name) is secret


@pytest.mark.parametrize("zenoh", [USER, TEXT])
def test_secrets_are_found(zenoh: Any) -> None:
    assert secret_values(zenoh) == {WORD}


def test_an_endpoints_own_settings_are_looked_at() -> None:
    zenoh = {"connect": {"endpoints": ["tls/h:1#connect_private_key_base64=UVdF;so=1"]}}
    assert secret_values(zenoh) == {"UVdF"}


@pytest.mark.parametrize(
    "text",
    [
        "zenoh: {transport: {auth: {usrpwd: {password: hunter2}}}}\n",
        "zenoh:\n  transport:\n    auth:\n      usrpwd: {user: me, password: 'hunter2'}  # not hunter3, hunter2\n",
        "zenoh: |\n  {transport: {auth: {usrpwd: {password: 'hunter2'}}}}\nnodes: {}\n",
        "parameters: {word: hunter2}\nzenoh: {transport: {auth: {usrpwd: {password: '${word}'}}}}\n",
        "parameters: {word: &word hunter2}\nzenoh: {transport: {auth: {usrpwd: {password: *word}}}}\n",
    ],
)
def test_a_files_text_is_kept_without_them_and_still_read(text: str) -> None:
    public = public_text(text, USER)
    assert WORD not in public
    assert yaml.safe_load(public).keys() == yaml.safe_load(text).keys()


def test_a_short_secret_does_no_harm_to_other_words() -> None:
    text = "hierarchy: a\nnodes: {a: {class: 'a:A'}}\nzenoh: {password: a}\n"
    public = yaml.safe_load(public_text(text, {"password": "a"}))
    assert public == {"hierarchy": "a", "nodes": {"a": {"class": "a:A"}}, "zenoh": {"password": "(not stored)"}}


def test_settings_are_kept_without_secret_values_and_completed_again() -> None:
    given = ["noise=1", f"zenoh.transport.auth.usrpwd.password={WORD}", f"word={WORD}", "zenoh.mode=peer"]
    kept = public_settings(given, USER)
    assert kept == ("noise=1", "zenoh.transport.auth.usrpwd.password", "word", "zenoh.mode=peer")
    assert usable(kept) == ["noise=1", "zenoh.mode=peer"]
    assert public_settings(kept, USER) == kept
    assert completed(kept, [given[2], given[1]]) == given
    with pytest.raises(HieraxError, match=r"--set word gave is secret and was not stored; give it again: --set word="):
        completed(kept, [given[1]])
    with pytest.raises(HieraxError, match=r"--set noise: the run knows its settings"):
        completed(kept, [*given[1:3], "noise=2"])


def test_errors_name_a_secret_setting_without_its_value() -> None:
    assert public_setting(f"zenoh.transport.auth.usrpwd.password={WORD}") == "zenoh.transport.auth.usrpwd.password=…"
    assert public_setting("noise=1") == "noise=1"
