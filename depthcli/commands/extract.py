"""Turn recordings (ROS bags, MCAP) into image folders.

Images whose times agree become the folders that the other commands read, with calibration and poses where the
recording has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, TypedDict

from depthcli.commands._batch import BatchCommand
from depthcli.commands._options import DRY_RUN, RUN, SCENES
from depthcli.core.errors import ConfigError, DepthcliError
from depthcli.core.option import Option
from depthcli.io.scenes.recording import RecordingScene, recording_scenes
from depthcli.run.command import SOME_FAILED, Outcome, Values
from depthcli.run.console import SIZE, Column, Reporter, aligned
from depthcli.run.json_csv import Row, to_json

_ROLES = ("left", "right", "color", "depth", "pose")
# Milliseconds: the views of a pair are triggered together; color and depth of a sensor at 30 Hz need not be.
_TOLERANCES = {True: 10.0, False: 20.0}


class ExtractOptions(TypedDict):
    """Options of a run of ``extract``, as ``run.yaml`` holds them; None: not given."""

    left_topic: str | None
    right_topic: str | None
    color_topic: str | None
    depth_topic: str | None
    pose_topic: str | None
    every: int
    tolerance: float | None
    depth_scale: float | None


def _topic(role: str, what: str) -> Option:
    return Option(f"{role}_topic", str, what, "TOPIC", group="Input")


class ExtractCommand(BatchCommand[ExtractOptions, RecordingScene]):
    """``depthcli extract RECORDING... --output DIR --left-topic TOPIC --right-topic TOPIC``."""

    results: ClassVar[tuple[str, ...]] = (
        "left/*", "right/*", "color/*", "depth/*", "*/depth.*", "*/meta.json", "calib.txt", "calib_left.yaml",
        "calib_right.yaml", "meta.json", "poses.txt", "times.csv",
    )  # fmt: skip

    arguments = (
        Option(
            "recordings", Path, "Bag, MCAP file, folder of ROS 2, or folder of those.", "RECORDING",
            repeatable=True, required=True, group="Input",
        ),
    )  # fmt: skip

    options = (
        Option("output", Path, "Folder to write into.", "DIR", short="-o", group="Output"),
        _topic("left", "Left view. Default: the only pair of topics."),
        _topic("right", "Right view."),
        _topic("color", "Color images, instead of two views."),
        _topic("depth", "Depth maps, with color or alone."),
        _topic("pose", "Poses: PoseStamped, Odometry, tf or the like."),
        Option("every", int, "Only every N-th frame.", "N", default=1, min_value=1, group="Input"),
        Option("tolerance", float, "Largest offset of the images of a frame. Default: 10, with depth 20.", "MS",
               min_value=0.0, max_value=60_000.0, group="Input"),
        Option("depth_scale", float, "Codes a meter of 16-bit depth. Default: as recorded, or 1000.", "CODES",
               min_value=1e-3, max_value=1e6, group="Input"),
        Option("list_topics", bool, "Print the topics of the recordings; write nothing.", default=False, group="Run"),
        SCENES,
        *RUN,
        DRY_RUN,
    )  # fmt: skip

    page = "how_to/recordings"
    examples = (
        "depthcli extract drive.bag -o out --left-topic /left --right-topic /right",
        "depthcli extract room.mcap -o frames --pose-topic /odom --every 5",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Extract the frames of every recording, or list topics; return the exit code."""
        from depthcli.commands._recorded_topics import check_roles
        from depthcli.io.formats.recordings import check_library
        from depthcli.io.walk import chosen_scenes

        check_library()
        check_roles({role: values[f"{role}_topic"] for role in _ROLES})
        scenes = recording_scenes(values["recordings"])
        if values["list_topics"]:
            return _list_topics(scenes, values, reporter)
        if values["output"] is None:
            raise ConfigError("give --output DIR, or --list-topics")
        chosen = [s for s in chosen_scenes(scenes, values["scenes"] or ["*"], values["recordings"][0])
                  if isinstance(s, RecordingScene)]  # fmt: skip
        config = ExtractOptions(
            left_topic=values["left_topic"], right_topic=values["right_topic"], color_topic=values["color_topic"],
            depth_topic=values["depth_topic"], pose_topic=values["pose_topic"], every=values["every"],
            tolerance=values["tolerance"], depth_scale=values["depth_scale"],
        )  # fmt: skip
        self._is_complete = True
        code = self.run_on(config, chosen, values, reporter)
        return code or (0 if self._is_complete else SOME_FAILED)

    _is_complete = True

    def notes(self, config: ExtractOptions, scenes: Sequence[RecordingScene], rows: Sequence[Row]) -> list[str]:
        """Note recordings of which something could not be used, which the exit code says, too."""
        lost = [str(row["scene"]) for row in rows if row.get("damaged") or row.get("calibration") == "refused"]
        self._is_complete = not lost
        return [f"of {', '.join(lost)} not everything could be used"] if lost else []

    def columns(self) -> tuple[Column, ...]:
        """Return size, frames, what is lost, offsets of times and their limit, and what is known of the cameras."""

        def milliseconds(key: str) -> Column:
            return Column(key.replace("_", " "), lambda row: f"{row[key]:.1f} ms" if row.get(key) is not None else "-")

        def count(key: str) -> Column:
            return Column(key, lambda row: str(row.get(key, "-")))

        return (
            SIZE, *map(count, ("frames", "unmatched", "damaged")),
            *map(milliseconds, ("median_offset", "max_offset", "tolerance")), *map(count, ("poses", "calibration")),
        )  # fmt: skip

    def compute(self, config: ExtractOptions, scene: RecordingScene, folder: Path, memory: int) -> Outcome:
        """Extract the frames of one recording.

        Raises
        ------
        InputError
            The recording cannot be read, or holds no such topics, or no frame.
        """
        import statistics

        from depthcli.commands import _extracted_facts as facts
        from depthcli.commands._extraction import match_frames, write_images
        from depthcli.commands._recorded_topics import choose_topics
        from depthcli.commands._recording_survey import survey
        from depthcli.core.result import Clock
        from depthcli.io.formats.recordings import open_recording

        scene.check()
        clock = Clock()
        given = {"left": config["left_topic"], "right": config["right_topic"], "color": config["color_topic"],
                 "depth": config["depth_topic"], "pose": config["pose_topic"]}  # fmt: skip
        with open_recording(scene.path) as recording:
            clock.start("times")
            topics = choose_topics(recording.topics, given)
            limit = config["tolerance"]
            tolerance = _TOLERANCES[topics.is_stereo] if limit is None else limit
            found = survey(recording, topics)
            frames, n_matched = match_frames(found, topics, tolerance, config["every"])
            clock.start("images")
            written = write_images(recording, topics, frames, folder, found)
        clock.start("save")
        calibration = facts.write_calibration(found, topics, written, folder)
        scale = config["depth_scale"] or (1 / found.depth_unit if found.depth_unit else None)
        if "depth" in topics.images and scale is not None:
            calibration.meta["depth_scale"] = float(f"{scale:.6g}")
        poses, notes = facts.poses_of(found, topics, written.frames) if topics.pose else ({}, [])
        if topics.is_depth_alone:  # every frame is a folder, with all that is known of it
            for frame in written.frames:
                pose = {"pose": poses[frame.number].round(12).tolist()} if frame.number in poses else {}
                place = folder / f"{frame.number:0{written.digits}}"
                facts.write_meta(calibration.meta | pose, topics, scene.path.name, place)
        else:
            facts.write_meta(calibration.meta, topics, scene.path.name, folder)
            facts.write_poses(poses, folder)
        facts.write_times(written.frames, folder)
        height, width = next(iter(written.shapes.values()))
        offsets = [abs(frame.offset) / 1e6 for frame in written.frames] if len(topics.images) > 1 else []
        row: Row = {
            "width": width,
            "height": height,
            **{f"{role}_topic": name for role, name in topics.images.items()},
            "frames": len(written.frames),
            "unmatched": max(len(stream.stamps) for stream in found.streams.values()) - n_matched,
            "damaged": found.n_damaged,
            "median_offset": round(statistics.median(offsets), 6) if offsets else None,
            "max_offset": round(max(offsets), 6) if offsets else None,
            "tolerance": tolerance if offsets else None,
            "poses": len(poses),
            "calibration": calibration.kept,
        }
        more = found.n_damaged - len(found.problems)
        warnings = [*found.problems, *([f"{more} more messages are damaged"] if more > 0 else [])]
        if found.by_recorder:
            warnings.append("images have no times of their own: those of the recorder are matched")
        return Outcome(row, clock.seconds, [*warnings, *calibration.notes, *notes])


def _list_topics(scenes: Sequence[RecordingScene], values: Values, reporter: Reporter) -> int:
    """Print the topics of every recording; one that cannot be read is said, and the others are listed."""
    from depthcli.io.formats.recordings import open_recording

    lines: list[tuple[str, ...]] = [("recording", "topic", "type", "messages", "rate")]
    rows: list[Row] = []
    failed = False
    for scene in scenes:
        try:
            scene.check()
            with open_recording(scene.path) as recording:
                topics = list(recording.topics.values())
        except ConfigError:
            raise
        except DepthcliError as error:
            reporter.error(str(error))
            failed = True
            continue
        for each in topics:
            rows.append({"recording": scene.name, "topic": each.name, "type": each.kind, "messages": each.count,
                         "rate": round(each.rate, 3)})  # fmt: skip
            lines.append((scene.name, each.name, each.kind, str(each.count), f"{each.rate:.1f} Hz"))
    if values["json"]:
        reporter.data(to_json(rows))
    elif rows and not values["quiet"]:
        reporter.data(aligned(lines))
    return SOME_FAILED if failed else 0


COMMAND = ExtractCommand()
