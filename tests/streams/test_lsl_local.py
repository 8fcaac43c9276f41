"""Settings by which an outlet is announced on this computer alone."""

from __future__ import annotations

from configparser import ConfigParser

from smoother.streams.lsl_local import local_settings


def read(text: str) -> ConfigParser:
    parser = ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return parser


def test_a_users_settings_stay_but_for_how_far_streams_are_announced(tmp_path):
    file = tmp_path / "lsl_api.cfg"
    file.write_text(
        "[lab]\nSessionID = mine ; of the room\n[multicast]\nResolveScope = site\n[ports]\nBasePort = 17000\n"
    )
    parser = read(local_settings(file))
    assert parser["lab"]["SessionID"] == "mine"
    assert parser["ports"]["BasePort"] == "17000"
    assert parser["multicast"]["ResolveScope"] == "machine"
    assert parser["multicast"]["ListenAddress"] == "127.0.0.1"
    assert parser["log"]["level"] == "-3"
    (tmp_path / "damaged.cfg").write_text("no section")
    for unread in (None, tmp_path / "missing.cfg", tmp_path / "damaged.cfg"):
        assert read(local_settings(unread))["multicast"]["ResolveScope"] == "machine"
