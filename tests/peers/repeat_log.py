"""Generates a longer nuScenes log from a short one by repeating its scene.

    python3 tests/peers/repeat_log.py /data/short /data/long --times 10

Every repetition has its own tokens, instances and times; sweeps and images are links to those of the short log. The
memory that `pskel build` needs for both shows whether it grows with a log's length:

    /usr/bin/time -f "%e s, %M kB" pskel build nuscenes:/data/long --out skeleton
"""

import argparse
import json
import pathlib

SHARED = ["sensor", "calibrated_sensor", "category", "attribute", "visibility", "log", "map"]
PAUSE_US = 200_000


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("short", type=pathlib.Path)
    parser.add_argument("long", type=pathlib.Path)
    parser.add_argument("--version", default="v1.0-mini")
    parser.add_argument("--times", type=int, default=10)
    args = parser.parse_args()
    tables = args.short / args.version
    read = lambda name: json.loads((tables / f"{name}.json").read_text())
    [scene] = read("scene")
    samples = {s["token"]: s for s in read("sample")}
    chain = [scene["first_sample_token"]]
    while samples[chain[-1]]["next"]:
        chain.append(samples[chain[-1]]["next"])
    length_us = samples[chain[-1]]["timestamp"] - samples[chain[0]]["timestamp"] + PAUSE_US
    out = {name: [] for name in ["sample", "sample_data", "ego_pose", "instance", "sample_annotation"]}
    for turn in range(args.times):
        other = lambda token: f"{token}-{turn}" if token else token
        for name, keys in [
            ("sample_data", ["token", "sample_token", "ego_pose_token"]),
            ("ego_pose", ["token"]),
            ("instance", ["token"]),
            ("sample_annotation", ["token", "sample_token", "instance_token"]),
        ]:
            for record in read(name):
                record.update({key: other(record[key]) for key in keys})
                if "timestamp" in record:
                    record["timestamp"] += turn * length_us
                out[name].append(record)
        for i, token in enumerate(chain):
            last = i + 1 == len(chain)
            follower = f"{chain[0]}-{turn + 1}" if last else other(chain[i + 1])
            end = last and turn + 1 == args.times
            record = dict(samples[token], token=other(token), next="" if end else follower)
            record["timestamp"] += turn * length_us
            out["sample"].append(record)
    out["scene"] = [dict(scene, first_sample_token=f"{chain[0]}-0")]
    for name in SHARED:
        out[name] = read(name)
    folder = args.long / args.version
    folder.mkdir(parents=True)
    for name, records in out.items():
        (folder / f"{name}.json").write_text(json.dumps(records))
    for name in ["samples", "sweeps", "maps"]:
        if (args.short / name).exists():
            (args.long / name).symlink_to((args.short / name).resolve())
    print(f"{args.long}: {len(out['sample'])} frames")


if __name__ == "__main__":
    main()
