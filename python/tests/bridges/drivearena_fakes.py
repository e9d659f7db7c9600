"""Servers of DriveArena, written from the requests of its simulator and the answers of its servers."""

import base64
import io
import json
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from PIL import Image

H, W, VIEWS = 224, 400, 6


def png(pixels: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
    return file.getvalue()


class Fake(ThreadingHTTPServer):
    """Both servers at once. ``fails`` names what is wrong with answers from the ``after``-th request on."""

    daemon_threads = True

    def __init__(self, fails: str = "", after: int = 0, agent: str = "uniad", speed_mps: float = 4.0) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.fails, self.after, self.agent, self.speed_mps = fails, after, agent, speed_mps
        self.requests: list[Any] = []
        self.outputs: deque[Any] = deque()
        self.cleaned = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def dream(self, data: Any) -> tuple[int, str, bytes]:
        """Images whose pixels are ten times the number of the camera plus the number of the request."""
        for key, shape in (("relative_pose", (4, 4)), ("drivable_mask", (200, 200))):
            assert np.array(data[key], np.float64).shape == shape
        assert np.array(data["metas"]["ego_pos"]).shape == (4, 4)
        assert "{location}. {description}".format(**data["metas"])
        assert len(data["gt_bboxes_3d"]) == len(data["gt_labels_3d"]) and all(len(box) == 9 for box in data["gt_bboxes_3d"])
        assert len(data["gt_vecs_label"]) == len(data["gt_lines_instance"])
        assert all(np.array(line).shape[1:] == (2,) for line in data["gt_lines_instance"])
        image = np.zeros((VIEWS, H, W, 3), np.uint8)
        image += (10 * np.arange(VIEWS, dtype=np.uint8) + len(self.requests) - 1)[:, None, None, None]
        return 200, "image/png", png(image.reshape(VIEWS * H, W, 3))

    def plan(self, data: Any) -> None:
        """A plan straight ahead, half a meter to the right at its end."""
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(data["img_byte_array"]))).convert("RGB"))
        data["images"] = image.reshape(VIEWS, H, W, 3)
        points = [[0.5 * i / 6, self.speed_mps * 0.5 * i] for i in range(1, 7)]
        if self.is_failing("nan"):
            points[2][0] = float("nan")
        if self.is_failing("shape"):
            points = [[*point, 0.0] for point in points]
        if not self.is_failing("silent"):
            bev = {"bev_pred_img": base64.b64encode(png(np.zeros((4, 4, 3)))).decode()}
            uniad = {"bbox_results": [{"planning_traj": [points]}], **bev}
            self.outputs.append(uniad if self.agent == "uniad" else [{"planning_traj": points, **bev}])

    def is_failing(self, how: str) -> bool:
        return self.fails == how and len(self.requests) > self.after


class Handler(BaseHTTPRequestHandler):
    server: Fake

    def do_GET(self) -> None:
        if self.path in ("/dreamer-clean/", "/driver-clean/"):
            self.server.cleaned += 1
            self.server.outputs.clear()
            if self.server.fails == "unasked":
                self.server.outputs.append([{"planning_traj": [[0.0, 1.0]]}])
            self.answer(200, "application/json", b"null")
        elif self.path == "/driver-get/" and self.server.outputs:
            self.answer(200, "application/json", json.dumps(self.server.outputs.popleft()).encode())
        else:
            self.answer(204 if self.path == "/driver-get/" else 404, "application/json", b"")

    def do_POST(self) -> None:
        data = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.requests.append(data)
        if self.server.is_failing("status"):
            self.answer(500, "text/plain", b"Internal Server\nError: CUDA out of memory")
        elif self.server.is_failing("hang"):
            time.sleep(5)
        elif self.path == "/driver-api/":
            self.server.plan(data)
            self.answer(200, "application/json", b"1")
        else:
            status, kind, content = self.server.dream(data)
            if self.server.is_failing("text"):
                kind, content = "text/html", b"<html>busy</html>"
            if self.server.is_failing("size"):
                content = png(np.zeros((VIEWS * H, W // 2, 3)))
            if self.server.is_failing("cut"):
                content = content[:300]
            self.answer(status, kind, content, slow=self.server.is_failing("slow"))

    def answer(self, status: int, kind: str, content: bytes, slow: bool = False) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content) + (9 if self.server.is_failing("short") else 0)))
        self.end_headers()
        for part in (content[i : i + 10] for i in range(0, len(content), 10)) if slow else [content]:
            self.wfile.write(part)
            time.sleep(0.2 if slow else 0)

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def serving(*arguments: Any, **options: Any) -> Iterator[Fake]:
    """A server for a test."""
    with Fake(*arguments, **options) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
