"""Rerun recordings of MCAP files: ``python -m pskel.rerun F.mcap --out F.rrd``.

Reads the files of ``pskel simulate --mcap`` and ``pskel export --layout mcap``. Rerun opens these files itself, too, but shows no
boxes and plans there (rerun-sdk 0.41 has no view of Foxglove's SceneUpdate). The recording has the timeline ``time`` and the entities

- ``/map/ego``, ``/map/ego/camera/CAM``: poses. The origin of ``/map`` is the first position of the ego in the log.
- ``/map/ego/camera/CAM/MAP``: an image with its pinhole camera. ``generated``, ``truth`` and ``image`` (recorded) are such, too.
- ``/map/actors``, ``/map/ego/box``: boxes; ``/map/plan``: the plan; ``/log``: events.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

try:
    import rerun as rr
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
except ImportError as error:
    raise ImportError("pskel.rerun needs Rerun and MCAP: pip install 'pskel[rerun]'") from error

import numpy as np

__all__ = ["convert"]

_LEVELS = ["INFO", "DEBUG", "INFO", "WARN", "ERROR", "CRITICAL"]  # at Rerun, by Foxglove's number


def convert(source: str | os.PathLike[str], out: str | os.PathLike[str]) -> Counter[str]:
    """Convert an MCAP file to a Rerun recording, which replaces an earlier one once it is complete.

    Returns how many ``poses`` (of ego and cameras), ``images``, ``boxes``, ``lines`` and ``events`` it has. Raises ``OSError`` if a
    file cannot be read or written, and ``ValueError`` if ``source`` is not an MCAP file of ``pskel``.
    """
    source, out = Path(source), Path(out)
    part = out.with_name(f".{out.name}.pskel-part")
    with source.open("rb") as file:
        part.touch()  # Rerun reports no error
        recording = rr.RecordingStream("pskel", recording_id=source.stem)
        try:
            recording.save(part)
            recording.log("/map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            counts = _Writer(recording).read(file, source)
            recording.disconnect()
            os.replace(part, out)
        finally:
            part.unlink(missing_ok=True)
    return counts


class _Writer:
    def __init__(self, recording: rr.RecordingStream) -> None:
        self.recording = recording
        self.counts: Counter[str] = Counter()
        self.paths = {"map": "/map"}  # entities of frames
        self.pinholes: dict[str, rr.Pinhole] = {}  # latest, by the topic of their calibration

    def read(self, file: Any, source: Path) -> Counter[str]:
        try:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for schema, channel, message, decoded in reader.iter_decoded_messages():
                write = getattr(self, "write_" + schema.name.rsplit(".")[-1], None) if schema else None
                if write is None:
                    raise McapError(f"a message of topic {channel.topic}")
                self.recording.set_time("time", timestamp=np.datetime64(message.log_time, "ns"))
                write(channel.topic, decoded)
        except (KeyError, McapError) as error:  # KeyError: an unknown frame or calibration
            raise ValueError(f"expected an MCAP file of pskel, found {error or type(error).__name__}: {source}") from error
        return self.counts

    def log(self, path: str, archetype: Any, kind: str, count: int = 1) -> None:
        self.recording.log(path, archetype)
        self.counts[kind] += count

    def write_FrameTransforms(self, _: str, message: Any) -> None:
        for item in message.transforms:
            path = f"{self.paths[item.parent_frame_id]}/{item.child_frame_id}"
            self.paths[item.child_frame_id] = path
            pose = rr.Transform3D(translation=_xyz(item.translation), quaternion=_quaternion(item.rotation))
            self.log(path, pose, "poses")

    def write_CameraCalibration(self, topic: str, message: Any) -> None:
        matrix = np.reshape(message.K, (3, 3))
        self.pinholes[topic] = rr.Pinhole(image_from_camera=matrix, width=message.width, height=message.height)

    def write_CompressedImage(self, topic: str, message: Any) -> None:
        kind = topic.removeprefix(f"/{message.frame_id}").removesuffix("/image") or "/image"
        path = self.paths[message.frame_id] + kind
        self.recording.log(path, self.pinholes[topic.rsplit("/", 1)[0] + "/calibration"])
        self.log(path, rr.EncodedImage(contents=message.data, media_type=f"image/{message.format}"), "images")

    def write_SceneUpdate(self, topic: str, message: Any) -> None:
        frame = message.entities[0].frame_id if message.entities else "map"
        path = self.paths[frame] + ("/box" if topic == f"/{frame}" else topic)
        cubes = [cube for entity in message.entities for cube in entity.cubes]
        strips = [line for entity in message.entities for line in entity.lines]
        if strips:
            points = [[_xyz(point) for point in line.points] for line in strips]
            lines = rr.LineStrips3D(points, colors=[_rgba(line) for line in strips])
            self.log(path, lines, "lines", len(strips))
            return
        boxes = rr.Boxes3D(
            centers=[_xyz(cube.pose.position) for cube in cubes],
            sizes=[_xyz(cube.size) for cube in cubes],
            quaternions=[_quaternion(cube.pose.orientation) for cube in cubes],
            colors=[_rgba(cube) for cube in cubes],
            labels=[entity.id for entity in message.entities for _ in entity.cubes],
            show_labels=False,
        )
        self.log(path, boxes, "boxes", len(cubes))

    def write_Log(self, _: str, message: Any) -> None:
        text = f"{message.name}: {message.message}"
        self.log("/log", rr.TextLog(text, level=_LEVELS[message.level]), "events")


def _xyz(message: Any) -> list[float]:
    return [message.x, message.y, message.z]


def _quaternion(message: Any) -> rr.Quaternion:
    return rr.Quaternion(xyzw=[message.x, message.y, message.z, message.w])


def _rgba(message: Any) -> list[int]:
    return [round(255 * part) for part in (message.color.r, message.color.g, message.color.b, message.color.a)]


def main(arguments: Sequence[str]) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m pskel.rerun", description="Convert an MCAP file of pskel to a Rerun recording.")
    parser.add_argument("mcap", metavar="F.mcap", type=Path, help="file of pskel simulate --mcap or pskel export --layout mcap")
    parser.add_argument("--out", metavar="F.rrd", type=Path, required=True, help="recording to write")
    given = parser.parse_args(arguments)
    try:
        counts = convert(given.mcap, given.out)
    except (OSError, ValueError) as error:
        print(f"pskel.rerun: {error}", file=sys.stderr)
        return 1
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()) + f": {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
