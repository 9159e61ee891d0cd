"""What every layout promises."""

from __future__ import annotations

import tempfile
from pathlib import Path

from depthcli.core.text import one_line
from depthcli.io.layouts import Folder, Layout, own_layouts
from depthcli.io.scenes import Scene


def check_layout(layout: Layout, folder: Path) -> None:
    """Raise AssertionError unless a layout finds usable scenes in a folder of its own, and none elsewhere.

    Parameters
    ----------
    layout : what is tested
    folder : holds scenes of this layout, itself or in folders directly below; their images are read
    """
    assert layout.wants and layout.wants == one_line(layout.wants), "wants: want one line that names the files"
    assert issubclass(layout.kind, Scene), f"kind: want a class of scenes, got {layout.kind}"
    holding = [each for each in (folder, *sorted(folder.iterdir())) if each.is_dir() and _scenes(layout, each)]
    assert holding, f"{layout.name} finds no scene in {folder}, nor in the folders in it"
    found = [scene for each in holding for scene in _scenes(layout, each)]
    names = [scene.name for scene in found]
    assert len(set(names)) == len(names), f"two scenes have one name: {sorted(names)}"
    for scene in found:
        assert isinstance(scene, layout.kind), f"{scene.name} is no {layout.kind.__name__}"
        assert scene.layout == layout.name, f"{scene.name} says layout {scene.layout!r}: make scenes by self.scene(...)"
        assert not scene.problem, f"{scene.name} cannot be used: {scene.problem}"
        missing = [str(file) for file in scene.input_files.values() if not file.is_file()]
        assert not missing, f"{scene.name} names files that are not there: {', '.join(missing)}"
        scene.load()
    for each in holding:
        rivals = [own.name for own in own_layouts() if own.name != layout.name and _scenes(own, each)]
        assert not rivals, f"{each} fits {layout.name} and {rivals[0]}: a user would have to say which"
    with tempfile.TemporaryDirectory() as other:
        (Path(other) / "notes.txt").write_text("nothing\n")
        assert not _scenes(layout, Path(other)), "it finds scenes in a folder that holds only notes.txt"


def _scenes(layout: Layout, folder: Path) -> list[Scene]:
    return layout.scenes(Folder(folder, folder.name, ""))
