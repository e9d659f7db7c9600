"""A client of HUGSIM without a network: hugsim_client.py DIR HOW. It unpickles and pickles as HUGSIM's clients do.

Writes what it saw to DIR/seen.N.npz and DIR/seen.N.json. HOW it fails at the second observation: none, nan, shape, dead, silent, none_plan,
code, objects, long.
"""

import json
import os
import pickle
import sys

import numpy as np


class Code:
    def __reduce__(self):
        return os.system, (f"touch {sys.argv[1]}/executed",)


def plan(how, speed):
    """Points straight ahead, half a meter to the right at the end."""
    points = np.array([[0.5 * i / 6, speed * 0.5 * i] for i in range(1, 7)], np.float32)
    kinds = {
        "nan": points * np.nan, "shape": points[:, :1], "none_plan": None, "code": Code(), "long": points.repeat(5000, axis=0),
        "objects": np.array([[Code()]], object), "text": "Done",
    }  # fmt: skip
    return kinds.get(how, points)


def main(folder, how):
    count = 0
    while True:
        with open(os.path.join(folder, "obs_pipe"), "rb") as pipe:
            data = pickle.loads(pipe.read())
        if data == "Done":
            with open(os.path.join(folder, "done"), "w") as file:
                file.write(str(count))
            return
        obs, info = data
        cameras = info.pop("cam_params")
        assert all(image.dtype == np.uint8 and image.flags.writeable for image in obs["rgb"].values())
        np.savez(os.path.join(folder, f"seen.{count}.npz"), **obs["rgb"], **{f"{name}.l2c": c["l2c"] for name, c in cameras.items()})
        with open(os.path.join(folder, f"seen.{count}.json"), "w") as file:
            json.dump({**info, "intrinsics": {name: camera["intrinsic"] for name, camera in cameras.items()}}, file)
        now = how if count == 1 else ""
        if now == "dead":
            sys.exit(1)
        with open(os.path.join(folder, "plan_pipe"), "wb") as pipe:
            if now == "silent":
                import time

                time.sleep(20)
            points = plan(now, max(info["ego_velo"], 4.0))
            pipe.write(pickle.dumps(points[:, :2] if isinstance(points, np.ndarray) and points.ndim == 2 and not now else points))
        count += 1


main(*sys.argv[1:])
