"""What the published ONNX exports of stereo networks take and give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from depthcli.methods.stereo.networks.images import ColorOrder, Normalization

ProfileName = Literal["hitnet", "crestereo", "raft-stereo", "igev", "foundation-stereo"]
Sign = Literal["positive", "negative"]


@dataclass(frozen=True)
class Profile:
    """Conventions of a network, each of which a field of the config replaces.

    Attributes
    ----------
    multiple : of the sides of images that it takes, where it takes more than one size
    sign : of its output where disparities are positive
    """

    normalization: Normalization = "0-255"
    color_order: ColorOrder = "rgb"
    multiple: int = 32
    sign: Sign = "positive"


DEFAULT = Profile()

PROFILES: dict[ProfileName, Profile] = {
    # PINTO_model_zoo 142_HITNET, as stereodemo and ONNX-HITNET-Stereo-Depth-estimation run it: one input of 6
    # channels, left RGB and right RGB, or of 2 grey ones (the network trained for ETH3D), from 0 to 1; sizes are
    # fixed; output (1, H, W, 1), "reference_output_disparity".
    "hitnet": Profile(normalization="0-1"),
    # PINTO_model_zoo 284_CREStereo, as stereodemo and ONNX-CREStereo-Depth-Estimation run it: left and right, or
    # ("combined") both at half size before both at full size, RGB from 0 to 255; sizes are fixed; output (1, 2, H, W)
    # whose first channel is the disparity.
    "crestereo": Profile(),
    # Exports of princeton-vl/RAFT-Stereo in test mode: left and right, RGB from 0 to 255 (the graph itself normalizes
    # them); outputs: flow at a fourth of the size, then at full size, along x: minus the disparity.
    "raft-stereo": Profile(sign="negative"),
    # Exports of gangweiX/IGEV and IGEV-plusplus in test mode: left and right, or one input of 6 channels, RGB from 0 to
    # 255 (the graph itself normalizes them); output: the disparity at full size.
    "igev": Profile(),
    # scripts/make_onnx.py of NVlabs/FoundationStereo: "left" and "right", RGB from 0 to 255 (the graph itself
    # normalizes them by ImageNet's moments); sizes are fixed; output "disp".
    "foundation-stereo": Profile(),
}
