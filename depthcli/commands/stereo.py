"""Match image pairs: disparity maps, status and previews."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.commands._pairs import PairCommand
from depthcli.core.option import Option
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.command import Values

if TYPE_CHECKING:
    from depthcli.device import Device
    from depthcli.methods.stereo.config import StereoConfig
    from depthcli.methods.stereo.stages import PairMatcher

_DEVICE = Option(
    "device", str, "Where to match: cpu, auto (a GPU if there is one), opencl or cuda, also with :N. Default: cpu.",
    "NAME",
    sets="device",
)  # fmt: skip


class StereoCommand(PairCommand["StereoConfig"]):
    """Stereo matching by a pipeline of ``methods/stereo/pipeline/``, here or on a device."""

    page = "tutorial"
    examples = (
        "depthcli stereo accurate --input scenes --output runs/accurate --html",
        "depthcli stereo fast --left l.png --right r.png --max-disparity 64 -o pair",
        "depthcli stereo accurate -i scenes -o runs/p2 --set optimization.p2=6",
    )

    @property
    def options(self) -> tuple[Option, ...]:
        return (*super().options, _DEVICE)

    def config_model(self) -> type[StereoConfig]:
        from depthcli.methods.stereo.config import StereoConfig

        return StereoConfig

    def config(self, values: Values) -> StereoConfig:
        """Return the config with the address of its device: a run continues where it began, or not at all."""
        from depthcli.api.matching import with_address

        return with_address(super().config(values))

    def matcher(self, config: StereoConfig, scene: StereoScene) -> PairMatcher:
        return config.pipeline

    def device(self, config: StereoConfig) -> Device | None:
        from depthcli.api.matching import device_of

        return device_of(config)

    def device_columns(self, config: StereoConfig) -> dict[str, str]:
        """Return the device, where the config names one."""
        from depthcli.core.method import device_implementation_of

        device = self.device(config)
        if device is None:
            return {} if config.device == "cpu" else {"device": config.device}
        where = f"{device.info.address}, {device.info.name}"
        if device_implementation_of(config.pipeline) is None:
            where = f"cpu: {config.pipeline.method_name()} has no kernels for {where}"
        return {"device": where}


COMMAND = StereoCommand()
