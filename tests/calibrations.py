"""A rig whose cameras are known, and its calibration in the files of every program that is read."""

from dataclasses import astuple
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import RectifiedRig, Rig
from tests.boards import opencv

SIZE = (240, 180)


def rotation(*degrees: float) -> np.ndarray:
    return cv2.Rodrigues(np.radians(np.array(degrees)))[0]


def rig(fisheye: bool = False, strength: float = 1.0) -> Rig:
    lens = (0.02, -0.01, 0.003, -0.001) if fisheye else (-0.12, 0.03, 0.001, -0.0008, 0.0)
    lenses = [
        Camera(np.array([[f, 0, cx], [0, f + 1.5, cy], [0, 0, 1]]), lens, SIZE, fisheye)
        for f, cx, cy in ((190.0, 121.0, 88.0), (194.0, 117.5, 91.0))
    ]
    turn = rotation(*(strength * np.array([1.6, -2.2, 1.1])))
    return Rig(*lenses, turn, turn @ np.array([-0.14, 0.006 * strength, -0.004 * strength]))


def halves(folder: Path, file: Path) -> list[Path]:
    """Two files of OpenCV, as its sample writes them: the cameras, and how they stand."""
    parts = [folder / "intrinsics.yml", folder / "extrinsics.yml"]
    cameras, mark, place = file.read_text().partition("R: !!")
    parts[0].write_text(cameras)
    parts[1].write_text("%YAML:1.0\n---\n" + mark + place)
    return parts


def ros(folder: Path, taken: Rig) -> list[Path]:
    found, files = taken.rectified(SIZE, SIZE), [folder / "left.yaml", folder / "right.yaml"]
    for file, lens, turn, projection in (
        (files[0], taken.left, found.rotation, found.projection),
        (files[1], taken.right, found.rotation_right, found.projection_right),
    ):
        fields: dict[str, Any] = {"image_width": SIZE[0], "image_height": SIZE[1], "camera_name": file.stem}
        fields["distortion_model"] = "equidistant" if lens.fisheye else "plumb_bob"
        matrices = {"camera_matrix": lens.matrix, "distortion_coefficients": lens.coefficients[None],
                    "rectification_matrix": turn, "projection_matrix": projection}  # fmt: skip
        for key, value in matrices.items():
            fields[key] = {"rows": len(value), "cols": len(value[0]), "data": value.ravel().tolist()}
        file.write_text(yaml.safe_dump(fields, sort_keys=False, default_flow_style=None))
    return files


def echo(folder: Path, taken: Rig, upper: bool = False) -> list[Path]:
    """Messages as ROS 2 prints them, two of each topic, or in lists and upper case as ROS 1 does."""
    files = [folder / "left.echo.yaml", folder / "right.echo.yaml"]
    names = {"d": "distortion_coefficients", "k": "camera_matrix", "r": "rectification_matrix",
             "p": "projection_matrix"}  # fmt: skip
    for file, info in zip(files, ros(folder, taken), strict=True):
        fields = yaml.safe_load(info.read_text())
        message = {"height": SIZE[1], "width": SIZE[0], "distortion_model": fields["distortion_model"]}
        message |= {key.upper() if upper else key: fields[name]["data"] for key, name in names.items()}
        message |= {"binning_x": 0, "binning_y": 0, "roi": {"x_offset": 0, "y_offset": 0, "do_rectify": False}}
        heads = ({"stamp": {"sec": k, "nanosec": 100 * k}, "frame_id": "optical"} for k in (1, 2))
        style = {"sort_keys": False, "default_flow_style": None if upper else False}
        file.write_text("".join(yaml.safe_dump({"header": head} | message, **style) + "---\n" for head in heads))
    return files


def kalibr(file: Path, taken: Rig) -> Path:
    fields = {
        name: {"camera_model": "pinhole", "distortion_model": "equidistant" if lens.fisheye else "radtan",
               "distortion_coeffs": list(lens.distortion[:4]), "intrinsics": list(astuple(lens.intrinsics)),
               "resolution": list(SIZE)}
        for name, lens in (("cam0", taken.left), ("cam1", taken.right))
    }  # fmt: skip
    place = np.column_stack([taken.rotation, taken.translation]).tolist()
    fields["cam1"]["T_cn_cnm1"] = [*place, [0.0, 0.0, 0.0, 1.0]]
    file.write_text(yaml.safe_dump(fields, default_flow_style=None))
    return file


def kitti(file: Path, taken: Rig) -> Path:
    """Cameras 2 and 3, both turned against camera 0."""
    turn, shift = rotation(3, -2, 1), np.array([0.06, 0.01, 0.02])
    moved = taken.rotation @ turn, taken.rotation @ shift + taken.translation
    text = "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\n"
    for number, lens, r, t in ((2, taken.left, turn, shift), (3, taken.right, *moved)):
        for key, value in (("S", np.array(SIZE)), ("K", lens.matrix), ("D", lens.coefficients), ("R", r), ("T", t)):
            text += f"{key}_0{number}: " + " ".join(f"{v:.15e}" for v in value.ravel()) + "\n"
    file.write_text(text)
    return file


def zed(file: Path, taken: Rig) -> Path:
    """The file of Stereolabs, with another size before that of the rig; distortions in either place."""

    def section(name: str, values: dict[str, float]) -> str:
        return f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in values.items()) + "\n"

    (rx, cv, rz), shift, text = cv2.Rodrigues(taken.rotation)[0].ravel(), taken.translation * 1000, ""
    for side, lens in (("LEFT", taken.left), ("RIGHT", taken.right)):
        names = ("k1", "k2", "k3", "k4") if lens.fisheye else ("k1", "k2", "p1", "p2", "k3")
        distortion = dict(zip(names, lens.distortion, strict=True))
        for mode, factor in (("FHD", 2.5), ("VGA", 1.0)):
            values = dict(zip(("fx", "fy", "cx", "cy"), factor * np.array(astuple(lens.intrinsics)), strict=True))
            text += section(f"{side}_CAM_{mode}", values | ({} if lens.fisheye else distortion))
        text += section(f"{side}_DISTO", distortion) if lens.fisheye else ""
    place = {"Baseline": -shift[0], "TY": shift[1], "TZ_VGA": shift[2], "RX_VGA": rx, "CV_VGA": cv, "RZ_VGA": rz}
    file.write_text(text + section("STEREO", place | dict.fromkeys(("RX_FHD", "CV_FHD", "RZ_FHD"), 0.5)))
    return file


RIGS = {  # name -> the files of a calibration in a folder, and the options that they need; "lens": of fisheye lenses
    **{f"opencv {end}": lambda at, taken, end=end: (
        [opencv(at / f"a.{end}", taken, "K1 D1 K2 D2 R T imageSize")], ["lens"]) for end in ("yml", "xml", "json")},
    "opencv, old names, mm": lambda at, taken: (
        [opencv(at / "mm.yml", taken, "M1 D1 M2 D2 R T", 0.001)], ["lens", "--unit", "mm"]),
    "opencv, squares of 24 mm": lambda at, taken: (
        [opencv(at / "squares.yml", taken, unit=0.024)], ["lens", "--unit", "24mm"]),
    "opencv, two files": lambda at, taken: (halves(at, opencv(at / "c.yml", taken)), ["lens"]),
    "ros": lambda at, taken: (ros(at, taken), []),
    "ros2 topic echo": lambda at, taken: (echo(at, taken), []),
    "rostopic echo": lambda at, taken: (echo(at, taken, upper=True), []),
    "kalibr": lambda at, taken: ([kalibr(at / "chain.yaml", taken)], []),
    "kitti": lambda at, taken: ([kitti(at / "calib_cam_to_cam.txt", taken)], []),
    "zed": lambda at, taken: ([zed(at / "SN123.conf", taken)], []),
}  # fmt: skip


def geometries(found: RectifiedRig) -> dict[str, tuple[str, str, list[str]]]:
    """Name of a format -> file name, its content for a rectified pair, and the options that it needs."""
    left, right = found.projection, found.projection_right.copy()
    right[0, 2] += 3  # of the right principal point
    one, other = (" ".join(f"{value:.12e}" for value in each.ravel()) for each in (left, right))
    k, nothing = left[:, :3], " ".join(12 * ["0.0"])
    cams = [f"cam{n}=[{k[0, 0]} 0 {k[0, 2] + 3 * n}; 0 {k[1, 1]} {k[1, 2]}; 0 0 1]" for n in (0, 1)]
    baseline = -right[0, 3] / right[0, 0]
    matrix = "<proj_mat{0} type_id='opencv-matrix'><rows>3</rows><cols>4</cols><dt>d</dt><data>{1}</data></proj_mat{0}>"
    booster = f"{matrix.format('L', one)}{matrix.format('R', other)}<baselineLR>{baseline * 1000}</baselineLR>"
    middlebury = "\n".join(cams) + "\n{}baseline={}\n{}"
    size = f"width={SIZE[0]}\nheight={SIZE[1]}\nndisp=64\n"
    return {
        "middlebury": ("calib.txt", middlebury.format("doffs=3\n", baseline * 1000, size), []),
        "eth3d, without doffs and size": ("calib.txt", middlebury.format("", baseline * 1000, ""), []),
        "middlebury in meters": ("calib.txt", middlebury.format("doffs=3\n", baseline, size), ["--unit", "m"]),
        "kitti, color": ("a.txt", f"P0: {nothing}\nP1: {nothing}\nP2: {one}\nP3: {other}\n", []),
        "kitti, grey": ("a.txt", f"P0: {one}\nP1: {other}\nP2: {nothing}\nP3: {nothing}\n", ["--cameras", "0,1"]),
        "kitti, raw": ("a.txt", f"P_rect_02: {one}\nP_rect_03: {other}\n", []),
        "booster": ("a.xml", f"<a>{booster}</a>", []),
        "foundation stereo": ("K.txt", f"{' '.join(map(str, k.ravel()))}\n{baseline}\n", []),
    }
