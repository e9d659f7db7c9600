#!/usr/bin/env python3
"""Writes a data set with tables as large as nuScenes trainval, to measure the cost of many scenes.

It has copies of one scene under other names, which share the sweeps and images of the scene.

    pskel town seed=7,frames=40,size=225x400 --out out/town
    benches/trainval.py out/town out/trainval [SCENES]
"""

import json
import os
import sys
from pathlib import Path

# Numbers of rows of trainval, from https://www.nuscenes.org/nuscenes (850 scenes).
SCENES = 850
SAMPLE_DATA = 2_631_083


def prefixed(row: dict, fields: list[str], prefix: str) -> dict:
    return {**row, **{name: prefix + row[name] for name in fields if row.get(name)}}


def main() -> None:
    base, out = Path(sys.argv[1]), Path(sys.argv[2])
    scenes = int(sys.argv[3]) if len(sys.argv) > 3 else SCENES
    version = next(base.glob("v1.0-*"))
    tables = {path.stem: json.loads(path.read_text()) for path in version.glob("*.json")}
    target = out / "v1.0-trainval"
    target.mkdir(parents=True, exist_ok=True)
    for name in ["samples", "sweeps", "maps"]:
        if (base / name).exists() and not (out / name).exists():
            (out / name).symlink_to(os.path.relpath(base / name, out))
    tokens = {
        "scene": ["token", "first_sample_token", "last_sample_token"],
        "sample": ["token", "scene_token", "next", "prev"],
        "sample_data": ["token", "sample_token", "ego_pose_token", "next", "prev"],
        "ego_pose": ["token"],
        "sample_annotation": ["token", "sample_token", "instance_token", "next", "prev"],
        "instance": ["token", "first_annotation_token", "last_annotation_token"],
    }
    # Radar and camera rows between frames make up the difference to trainval; the reader skips most of them.
    more = max(0, SAMPLE_DATA // SCENES - len(tables["sample_data"]))
    radar = {"token": "radar", "channel": "RADAR_FRONT", "modality": "radar"}
    calibrated = {**tables["calibrated_sensor"][0], "token": "radar", "sensor_token": "radar", "camera_intrinsic": []}
    for name, rows in tables.items():
        with open(target / f"{name}.json", "w") as file:
            file.write("[\n")
            first = True
            if name not in tokens:
                extra = {"sensor": [radar], "calibrated_sensor": [calibrated]}.get(name, [])
                file.write(",\n".join(json.dumps(row, indent=0) for row in rows + extra))
                file.write("\n]")
                continue
            for scene in range(scenes):
                prefix = f"{scene:04x}"
                for number, row in enumerate(rows):
                    row = prefixed(row, tokens[name], prefix)
                    if name == "scene":
                        row["name"] = f"scene-{scene:04}"
                    file.write(("" if first else ",\n") + json.dumps(row, indent=0))
                    first = False
                    if name in ("sample_data", "ego_pose"):
                        # Spread evenly between the rows of the scene.
                        for filler in range(more * number // len(rows), more * (number + 1) // len(rows)):
                            token = f"{prefix}{'f' * 20}{filler:08x}"
                            new = {**row, "token": token}
                            if name == "sample_data":
                                new |= {"ego_pose_token": token, "calibrated_sensor_token": "radar", "is_key_frame": False}
                            file.write(",\n" + json.dumps(new, indent=0))
            file.write("\n]")
    bytes_of = {path.name: path.stat().st_size for path in sorted(target.iterdir())}
    print(json.dumps(bytes_of, indent=1))


main()
