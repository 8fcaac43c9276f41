"""`unocclude config`: print the configuration."""

from __future__ import annotations

from .options import ConfigFile, Force, Json
from .output import check_outputs, say, write_json


def config(config_file: ConfigFile = None, json_file: Json = None, force: Force = False) -> None:
    """Print the configuration as TOML, the defaults or what a file makes of them."""
    from .config_file import read_config, to_toml

    check_outputs(force, [json_file], [config_file])
    settings = read_config(config_file)
    say(to_toml(settings).rstrip("\n"))
    write_json(json_file, settings.model_dump(mode="json"), force)
