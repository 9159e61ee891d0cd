"""Configs for Python: a preset, a file or a config object, with overrides."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from depthcli.api.wording import worded
from depthcli.core import config_file
from depthcli.core.config_file import ConfigData
from depthcli.run.presets import find_config, find_preset

ModelT = TypeVar("ModelT", bound=BaseModel)

Overrides = Mapping[str, object]
"""``a.b`` or plain name of a key -> value."""

COMMANDS = {
    "StereoConfig": "stereo",
    "FuseConfig": "fuse",
    "RefineKinectConfig": "refine-kinect",
    "TransparentConfig": "transparent",
    "RegisterConfidenceConfig": "register-confidence",
}
"""Name of the class of a config -> its command."""


@worded
def load_config(
    model: type[ModelT], preset: str | Path | ModelT, overrides: Overrides | None = None, **fields: object
) -> ModelT:
    """Return a checked config of a problem.

    Parameters
    ----------
    model : class of the config: ``StereoConfig``, ``FuseConfig``, ``RefineKinectConfig``, ``TransparentConfig`` or
        ``RegisterConfidenceConfig``
    preset : name of a preset (``depthcli presets`` lists them), path of a YAML file, or a config
    overrides : key -> value, as ``--set`` has them: ``{"cost.window": 9}``. A mapping as a value changes only the keys
        that it holds, unless it names a method
    **fields : the same for keys that are Python names

    Raises
    ------
    ConfigError
        No such preset or file, or keys and values that do not fit; all problems, one a line.

    Examples
    --------
    >>> import depthcli
    >>> config = depthcli.load_config(depthcli.StereoConfig, "accurate", {"optimization.p2": 6}, max_disparity=64)
    >>> config.max_disparity
    64
    """
    values = {key: _plain(value) for key, value in {**(overrides or {}), **fields}.items()}
    if isinstance(preset, model):
        if not values:
            return preset
        data = ConfigData("config", preset.model_dump(mode="json", by_alias=True))
        return config_file.load_config(model, data, values=values)
    command = COMMANDS[model.__name__]
    file = find_config(command, str(preset))
    return config_file.load_config(model, file, find=lambda name: find_preset(command, name), values=values)


def _plain(value: Any) -> Any:
    """Return a value as a YAML file would give it."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    return value.tolist() if hasattr(value, "tolist") else value  # numbers and arrays of numpy
