"""Networks in ONNX files, run by onnxruntime: what ``pipeline: onnx`` and ``cost: onnx`` have in common.

| module | what comes in -> what goes out |
|---|---|
| ``runtime`` | file of a network, device -> ``Session``: arrays by input's name -> arrays by output's name |
| ``images`` | image -> (C, H, W) float32 in the range and order of channels that a network takes; padding |
| ``profiles`` | name of a published network -> what its exports take and give |
| ``pairs`` | pair -> the left view's disparities, by a network with one, two or four image inputs |
| ``self_check`` | what maps a pair to disparities -> InputError where it does not find a known shift |
| ``features`` | image -> (C, H, W) features, one vector per pixel, by a network with one image input |
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from depthcli.methods.stereo.networks.runtime import Session, open_session


class Network(BaseModel):
    """What all methods that run a network have in common: its file, and the device that it runs on."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    model: str = Field(min_length=1, description="file of the network, .onnx; from the current folder")
    _device: str = PrivateAttr("cpu")

    @property
    def session(self) -> Session:
        """The network, opened at the first use in this process."""
        return open_session(self.model, self._device)

    def prepare(self, device: str) -> None:
        """Choose where the network runs, and check it there.

        Parameters
        ----------
        device : ``cpu`` or ``cuda:N``

        Raises
        ------
        InputError
            onnxruntime or the device is missing, the file cannot be read, or the network is not of the right kind.
        """
        self._device = device
        self.check()

    @abstractmethod
    def check(self) -> None:
        """Raise InputError where the network cannot be used."""


def networks_in(value: object) -> Iterator[Network]:
    """Return all networks of a config, whatever they are a part of."""
    if isinstance(value, Network):
        yield value
    parts: Iterator[object] = iter(())
    if isinstance(value, BaseModel):
        parts = (getattr(value, name) for name in type(value).model_fields)
    elif isinstance(value, Mapping):
        parts = iter(value.values())
    elif isinstance(value, list | tuple):
        parts = iter(value)
    for part in parts:
        yield from networks_in(part)


def model_files(config: object) -> dict[str, Path]:
    """Return role -> file of the networks of a config: ``model_0`` and so on, and files of weights beside them.

    Networks too large for one file keep weights in others, whose names begin with the network's (``net.onnx.data``,
    ``net.onnx_data``) or are ``net.data``.
    """
    names = dict.fromkeys(network.model for network in networks_in(config))
    files = {}
    for k, path in enumerate(map(Path, names)):
        beside = [file for file in path.parent.glob("*") if file.name.startswith((f"{path.name}.", f"{path.name}_"))]
        files[f"model_{k}"] = path
        weights = sorted({*beside, *(file for file in [path.with_suffix(".data")] if file.is_file())})
        files |= {f"model_{k}_weights_{i}": file for i, file in enumerate(weights)}
    return files
