"""The messages of AlpaSim: generated files, wire format against another package, and coexistence with it."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
GENERATOR = "1.62.3"
COMMITTED = ROOT / "python/pskel/alpasim"


@pytest.fixture
def protos(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """ci/protos.py, which needs grpcio-tools."""
    pytest.importorskip("grpc_tools")
    monkeypatch.syspath_prepend(str(ROOT / "ci"))
    return pytest.importorskip("protos")


def test_modules_have_the_schemas_of_the_proto_files(protos: ModuleType) -> None:
    from google.protobuf import descriptor_pb2
    from pskel.alpasim import common_pb2, egodriver_pb2, sensorsim_pb2, video_model_pb2

    modules = (common_pb2, sensorsim_pb2, egodriver_pb2, video_model_pb2)
    files = protos.descriptors().file
    assert [file.name for file in files] == [f"pskel/alpasim/{name}.proto" for name in ("common", "sensorsim", "egodriver", "video_model")]
    for file, module in zip(files, modules, strict=True):
        committed = descriptor_pb2.FileDescriptorProto()
        module.DESCRIPTOR.CopyToProto(committed)
        for message in (*committed.message_type, *file.message_type):
            _clear_json_names(message)
        assert committed == file, file.name


def _clear_json_names(message: Any) -> None:
    """Names in JSON follow from names of fields; not every tool writes them into a descriptor."""
    for field in message.field:
        field.ClearField("json_name")
    for nested in message.nested_type:
        _clear_json_names(nested)


def test_modules_equal_a_new_generation(protos: ModuleType, tmp_path: Path) -> None:
    from importlib.metadata import version

    if version("grpcio-tools") != GENERATOR:
        pytest.skip(f"needs grpcio-tools {GENERATOR}")
    protos.generate(tmp_path)
    new = {path.name: path.read_text() for path in (tmp_path / "pskel/alpasim").iterdir()}
    assert len(new) == 14
    assert new == {path.name: path.read_text() for path in COMMITTED.glob("*_pb2*.py*")}


def test_messages_are_those_of_another_implementation() -> None:
    """Both packages in one process, in either order, exchange messages."""
    pytest.importorskip("grpc")
    pytest.importorskip("carla_driver_interface")
    code = """
import importlib, sys
ours, theirs = (importlib.import_module(name) for name in sys.argv[1:])
if ours.__name__.startswith("carla"):
    ours, theirs = theirs, ours
from google.protobuf.json_format import MessageToDict
from pskel.alpasim import common_pb2, sensorsim_pb2
request = ours.DriveSessionRequest(session_uuid="a", random_seed=2**60, debug_info={"scene_id": "s"})
camera = request.rollout_spec.vehicle.available_cameras.add(logical_id="camera_front")
camera.rig_to_camera.CopyFrom(common_pb2.Pose(vec={"x": 1.5, "y": -2, "z": 3}, quat={"w": 0.5, "x": -0.5, "y": 0.5, "z": -0.5}))
pinhole = sensorsim_pb2.OpenCVPinholeCameraParam(
    principal_point_x=1, principal_point_y=2, focal_length_x=3, focal_length_y=4,
    radial_coeffs=[1, 2, 3], tangential_coeffs=[4, 5], thin_prism_coeffs=[6])
camera.intrinsics.CopyFrom(sensorsim_pb2.CameraSpec(
    opencv_pinhole_param=pinhole, logical_id="camera_front", resolution_h=5, resolution_w=6, shutter_type=sensorsim_pb2.GLOBAL))
image = ours.RolloutCameraImage(session_uuid="a", camera_image={
    "frame_start_us": 1, "frame_end_us": 2, "image_bytes": b"png", "logical_id": "camera_front"})
pose = {"pose": {"vec": {"x": 1}, "quat": {"w": 1}}, "timestamp_us": 7}
motion = ours.RolloutEgoTrajectory(session_uuid="a", trajectory={"poses": [pose]}, dynamic_states=[{
    "angular_velocity": {"z": 1}, "linear_velocity": {"x": 2}, "linear_acceleration": {"x": 3}, "angular_acceleration": {"z": 4}}])
route = ours.RouteRequest(session_uuid="a", route={"timestamp_us": 3, "waypoints": [{"x": 1}, {"y": 2}]})
drive = ours.DriveRequest(session_uuid="a", time_now_us=1, time_query_us=2, renderer_data=b"r")
answer = ours.DriveResponse(trajectory={"poses": [pose]}, terminate_session=True, debug_info={"unstructured_debug_info": b"d"})
truth = ours.GroundTruthRequest(session_uuid="a", ground_truth={"timestamp_us": 3, "trajectory": {"poses": [pose]}})
for message in request, image, motion, route, drive, answer, truth, ours.DriveSessionCloseRequest(session_uuid="a"):
    data = message.SerializeToString()
    other = getattr(theirs, type(message).__name__).FromString(data)
    assert MessageToDict(other) == MessageToDict(message) and other.ByteSize() == len(data), message
    assert type(message).FromString(other.SerializeToString()) == message
"""
    names = ["pskel.alpasim.egodriver_pb2", "carla_driver_interface.protocol"]
    for order in names, names[::-1]:
        done = subprocess.run([sys.executable, "-c", code, *order], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
