"""The Middlebury sets of 2001 to 2006, as their site distributes them."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import map_suffixes
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

# Scale of the ground truth and search range of the data sets of the taxonomy paper, which come without a
# file that says them (vision.middlebury.edu/stereo/data/scenes2001, scenes2003).
_FACTS: dict[str, tuple[float, int]] = {
    "tsukuba": (16, 15), "venus": (8, 19), "teddy": (4, 59), "cones": (4, 59), "sawtooth": (8, 19), "bull": (8, 20),
    "poster": (8, 20), "barn1": (8, 19), "barn2": (8, 19),
}  # fmt: skip
# Views of a pair, and the names of their ground truth.
_VIEWS = (
    ("im2", "im6", (("disp2", "disp6"), ("groundtruth", ""))),
    ("imL", "imR", (("disp2", "disp6"), ("groundtruth", ""))),
    ("view1", "view5", (("disp1", "disp5"),)),
)


class MiddleburyV2(Layout):
    """Pairs of the second evaluation and of the 2005 and 2006 sets."""

    kind = StereoScene
    protocol = "middlebury_v2"
    wants = (
        "`im2`/`im6`, `imL`/`imR` or `view1`/`view5` with `disp2`/`disp6`, `groundtruth` or `disp1`/`disp5`, and "
        "`nonocc`, `all`, `disc` where there are masks; the 2001, 2003, 2005 and 2006 sets"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        for left_stem, right_stem, truths in _VIEWS:
            left, right = folder.one(left_stem, IMAGE_SUFFIXES), folder.one(right_stem, IMAGE_SUFFIXES)
            if left is None or (right is None and folder.one(truths[0][0], map_suffixes()) is None):
                continue
            pairs = [[folder.one(stem, map_suffixes()) for stem in stems] for stems in truths]
            truth, truth_right = next((pair for pair in pairs if pair[0]), pairs[-1])
            later = left_stem == "view1"
            scale, top = (None, None) if later else _FACTS.get(folder.path.name.lower(), (None, None))
            masks = {
                name: file
                for name in ("nonocc", "all", "disc")
                if (file := folder.one(name, IMAGE_SUFFIXES) or folder.one(f"mask_{name}", IMAGE_SUFFIXES))
            }
            return [
                self.scene(
                    folder,
                    problem="" if right else f"{folder.path}: only one image of the pair, no {right_stem}.*",
                    left=left,
                    right=right,
                    disparity_left=truth,
                    disparity_right=truth_right,
                    disparity_scale=folder.meta.positive("disp_scale") or scale,
                    scale_by_width=later,
                    masks=masks,
                    max_disparity=folder.meta.whole("max_disparity", 1) or top,
                )
            ]
        return []
