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

from pydantic import BaseModel, Field, PrivateAttr

from depthcli.core.method import ConfigModel
from depthcli.methods.stereo.networks.runtime import Session, open_session


class Network(ConfigModel):
    """What all methods that run a network have in common: its file, and the device that it runs on."""

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

    def used_files(self) -> dict[str, Path]:
        """Return role -> file: the network, and weights of large ones in files beside it.

        Their names begin with the network's (``net.onnx.data``, ``net.onnx_data``), or are ``net.data``.
        """
        path = Path(self.model)
        prefixes = (f"{path.name}.", f"{path.name}_")
        weights = [file for file in path.parent.glob("*") if file.name.startswith(prefixes)]
        if path.with_suffix(".data").is_file():
            weights.append(path.with_suffix(".data"))
        return {"model": path} | {f"model/{file.name}": file for file in sorted(weights)}

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
