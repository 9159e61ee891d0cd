"""Requirements on a map's error bounds: set in configs, met by methods, checked by evaluations."""

from pydantic import Field

from depthcli.core.method import ConfigModel


class Bound(ConfigModel):
    """Requirements on a map: an error bound, and the probability of a small error."""

    level: float = Field(default=0.9, ge=0.5, le=0.99, description="share of the errors that are within the bound")
    within: float = Field(
        default=1.0, ge=0.25, le=8, description="error up to which a value is correct in probability.pfm, pixels"
    )


class DepthBound(Bound):
    """Requirements on a map in meters."""

    within: float = Field(
        default=0.03, ge=0.001, le=1, description="error up to which a value is correct in probability.pfm, meters"
    )


class VolumeBound(Bound):
    """Requirements on a registration of volumes, in mm."""

    within: float = Field(
        default=3.0, ge=0.5, le=50, description="error up to which a voxel is correct in the volume probability, mm"
    )
