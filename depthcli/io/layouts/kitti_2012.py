"""The folders of KITTI 2012."""

from __future__ import annotations

from depthcli.io.layouts.kitti_2015 import Kitti2015


class Kitti2012(Kitti2015):
    """As KITTI 2015, with other names and no object maps."""

    wants = "`colored_0`/`colored_1` or `image_0`/`image_1`, `disp_noc`, `disp_occ`, `calib`"
    protocol = "kitti_2012"
    views = (("colored_0", "colored_1"), ("image_0", "image_1"))
    truths = ("disp_occ", "disp_noc", "")
    calibrations = "calib"
