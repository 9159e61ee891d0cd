"""Match image pairs: a disparity map, its status and a preview for every scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from depthcli.batch.command import Values
from depthcli.commands._pairs import PairCommand
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.core.frames import StereoPair
    from depthcli.device import Device
    from depthcli.methods.stereo.large import Matcher
    from depthcli.methods.stereo.volume import StereoResult

_DEVICE = Option(
    "device", str, "Where to match: cpu, auto (a GPU if there is one), opencl or cuda, with :N. Default: cpu.", "NAME",
    sets="device",
)  # fmt: skip


class StereoCommand(PairCommand):
    """Any pipeline of ``stereo/pipeline/``."""

    @property
    def options(self) -> tuple[Option, ...]:
        """Those of all batches, and the device."""
        return (*super().options, _DEVICE)

    def config_model(self) -> type[BaseModel]:
        """A pipeline and the search range."""
        from depthcli.methods.stereo.config import StereoConfig

        return StereoConfig

    def config(self, values: Values) -> BaseModel:
        """With the device that is meant, by its address: a run goes on where it began, or not at all."""
        from depthcli.device import DeviceError, find_device

        config: Any = super().config(values)
        if config.device == "cpu":
            return config  # type: ignore[no-any-return]
        try:
            info = find_device(config.device)
        except DeviceError as error:
            raise ConfigError(str(error)) from error
        found: BaseModel = config.model_copy(update={"device": "cpu" if info is None else info.address})
        return found

    def match(self, config: Any, scene: StereoScene, pair: StereoPair, top: int) -> StereoResult:
        """By the config's pipeline, or its twin for devices."""
        device, twin = _device(config)
        if device is None or twin is None:
            result: StereoResult = config.pipeline(pair, top)
            return result
        from depthcli.batch.resources import show_bytes

        need, there = twin.peak_bytes(config.pipeline, pair.shape, top, device), device.info.memory
        if need > there:
            raise InputError(
                f"needs about {show_bytes(need)} on {device.info.address} ({device.info.name}), which has "
                f"{show_bytes(there)}; see --device, --max-disparity"
            )
        result = twin.run(config.pipeline, pair, top, device)
        return result

    def facts(self, config: Any) -> dict[str, Any]:
        """The device, where one was asked for."""
        device, twin = _device(config)
        if device is None:
            return {}
        where = f"{device.info.address}, {device.info.name}"
        if twin is None:
            where = f"cpu: {config.pipeline.method_name()} has no kernels for {where}"
        return {"device": where}

    def in_tiles(self, config: Any) -> Matcher | None:
        """Any pipeline can, on this machine's memory."""
        matcher: Matcher | None = config.pipeline if config.device == "cpu" else None
        return matcher

    def peak_bytes(self, config: Any, shape: tuple[int, int], top: int) -> int:
        """By the config's pipeline; what it holds on a device is not this machine's memory."""
        device, twin = _device(config)
        if device is not None and twin is not None and device.info.is_gpu:
            return 200 * shape[0] * shape[1] + (64 << 20)
        need: int = config.pipeline.peak_bytes(shape, top)
        return need


def _device(config: Any) -> tuple[Device | None, Any]:
    """The device of the config and the pipeline's twin for it, None where there is none."""
    from depthcli.core.method import twin_of
    from depthcli.device import open_device

    if config.device == "cpu":
        return None, None
    return open_device(config.device), twin_of(config.pipeline)


COMMAND = StereoCommand()
