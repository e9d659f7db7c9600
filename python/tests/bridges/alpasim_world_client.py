"""AlpaSim's own client of a world model, in an environment of AlpaSim: ``python alpasim_world_client.py ADDRESS USDZ OUT FRAMES LEFT_M HxW``.

It starts a session as AlpaSim does, from a USDZ file and with images of a size, asks for chunks along the recorded path moved to the
left, and writes the serialized messages as ``OUT/session``, ``OUT/0.request``, ``OUT/0.response``, ..
"""

import asyncio
import sys
from pathlib import Path

import numpy as np
from alpasim_runtime.broadcaster import MessageBroadcaster
from alpasim_runtime.camera_catalog import CameraCatalog
from alpasim_runtime.config import CameraDefinitionConfig, VideoModelConfig
from alpasim_runtime.services.session_configs import RendererSessionConfig
from alpasim_runtime.services.video_model_service import VideoModelService
from alpasim_runtime.types import Clock, RuntimeCamera
from alpasim_runtime.video_model.usdz_calibration import parse_cameras_from_usdz
from alpasim_runtime.video_model.utils import (
    build_dynamic_world_state_for_video_model,
    build_trajectory_for_video_model,
    extract_first_frames,
)
from alpasim_utils import geometry
from alpasim_utils.artifact import Artifact


class Recorder:
    """Writes the session's request."""

    def __init__(self, out: Path) -> None:
        self._out = out

    async def on_message(self, message) -> None:
        if message.HasField("video_model_session_request"):
            (self._out / "session").write_bytes(message.video_model_session_request.SerializeToString())


async def main(address: str, usdz: str, out: Path, frames: int, left_m: float, size: tuple[int, int]) -> None:
    artifact = Artifact(usdz, _smooth_trajectories=False)
    artifact.source = usdz
    names = sorted(set(parse_cameras_from_usdz(usdz)) & set(extract_first_frames(usdz)[1]))
    clock = Clock(interval_us=33_333, duration_us=0)
    cameras = [RuntimeCamera(logical_id=name, render_resolution_hw=(0, 0), clock=clock) for name in names]
    definitions = [CameraDefinitionConfig(logical_id=name, resolution_hw=size) for name in names]
    ego = artifact.rig.trajectory
    times = np.array(ego.timestamps_us)
    left = geometry.Pose(np.array([0, left_m, 0], np.float32), np.array([0, 0, 0, 1], np.float32))
    path = geometry.Trajectory.from_poses(times, [ego.get_pose(i) @ left for i in range(len(times))])
    service = VideoModelService(address, VideoModelConfig(), camera_catalog=CameraCatalog(definitions))
    config = RendererSessionConfig(
        data_source=artifact, runtime_cameras=cameras, gt_ego_trajectory=ego, image_format="png", ego_mask_rig_config_id=None
    )
    done, start_us = 0, int(times[0]) + service.frame_interval_us
    async with service.rollout_session("peer", MessageBroadcaster(handlers=[Recorder(out)]), config):
        while done < frames:
            chunk = (start_us + done * service.frame_interval_us, service.chunk_size, service.frame_interval_us)
            state = build_dynamic_world_state_for_video_model(artifact.traffic_objects, *chunk)
            result = await service.render_chunk(build_trajectory_for_video_model(path, *chunk), state)
            assert sorted(result.rgb_frames_per_camera) == names
            for images in result.rgb_frames_per_camera.values():
                assert [image.start_timestamp_us for image in images] == [chunk[0] + i * chunk[2] for i in range(chunk[1])]
            number = len(list(out.glob("*.request")))
            (out / f"{number}.request").write_bytes(result.raw_request.SerializeToString())
            (out / f"{number}.response").write_bytes(result.raw_response.SerializeToString())
            done += chunk[1]


if __name__ == "__main__":
    _, address, usdz, out, frames, left_m, size = sys.argv
    height, width = map(int, size.split("x"))
    asyncio.run(main(address, usdz, Path(out), int(frames), float(left_m), (height, width)))
