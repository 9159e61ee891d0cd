"""What every layout promises."""

from pathlib import Path

from depthcli.io.scenes import Folder, Layout, Scene
from depthcli.io.scenes.find import ALL_KINDS
from depthcli.io.scenes.rows import fitting
from tests.scenes import load


def check_layout(name: str, folder: Path) -> None:
    """Assert that the layout, and no other, finds usable scenes in a folder of its own, or in those in it."""
    (layout,) = (each for each in ALL_KINDS.rows if each.name == name)
    holding = [each for each in (folder, *sorted(folder.iterdir())) if each.is_dir() and _scenes(layout, each)]
    found = [scene for each in holding for scene in _scenes(layout, each)]
    assert found and len({scene.name for scene in found}) == len(found)
    for scene in found:
        assert isinstance(scene, layout.kind) and scene.layout == layout.name and not scene.problem
        assert all(file.is_file() for file in scene.input_files.values())
        load(scene)
    for each in holding:
        assert [own.name for own in ALL_KINDS.rows if _scenes(own, each)] == [layout.name]


def _scenes(layout: Layout, folder: Path) -> list[Scene]:
    here = Folder(folder, folder.name, "")
    return [scene for each in fitting((layout,), here.names) for scene in each.scenes(here)]
