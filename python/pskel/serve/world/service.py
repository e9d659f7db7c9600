"""The service ``omnidreams.video_model.WorldModelService``: sessions by their IDs."""

from __future__ import annotations

import io
import os
import sys
import time
import uuid
import zipfile
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import grpc

import pskel
from pskel.alpasim import common_pb2, video_model_pb2, video_model_pb2_grpc

from ..errors import RequestError, answered, invalid, unknown
from ..messages import version
from ..scenes import Scene, Scenes
from .session import Broken, Generator, Session, Settings
from .views import View, views

CLIP_PREFIX = "clipgt-"


class WorldModel(video_model_pb2_grpc.WorldModelServiceServicer):
    """Answers sessions about scenes with the generator of the settings. Sessions are independent; each has one call at a time."""

    def __init__(self, scenes: Scenes, settings: Settings) -> None:
        self._scenes = scenes
        self._settings = settings
        self._sessions: dict[str, Session] = {}
        self._starting = 0
        self._lock = Lock()
        self._pool = ThreadPoolExecutor(os.cpu_count())  # encodes images

    def get_version(self, request: common_pb2.Empty, context: Any) -> common_pb2.VersionId:
        return version()

    def start_session(self, request: video_model_pb2.SessionRequest, context: Any) -> video_model_pb2.SessionId:
        return answered(context, lambda: self._started(request))

    def render_video_chunk(
        self, request: video_model_pb2.VideoChunkRequest, context: Any
    ) -> video_model_pb2.VideoChunkReturn:
        """Answers a chunk. If it fails while images are generated, the session ends; a wrong request changes nothing."""

        def answer() -> video_model_pb2.VideoChunkReturn:
            session = self._session(request.session_id.session_id)
            with session.lock:
                self._session(session.name)  # may have ended meanwhile
                try:
                    return session.chunk(request, context, self._pool)
                except Broken as error:
                    self._end(session, "failed")
                    raise _ended(error.cause) from error.cause
                finally:
                    session.used_s = time.monotonic()

        return answered(context, answer)

    def close_session(self, request: video_model_pb2.SessionCloseRequest, context: Any) -> common_pb2.Empty:
        def answer() -> common_pb2.Empty:
            session = self._session(request.session_id)
            with session.lock:
                self._session(session.name)
                self._end(session, "closed")
            return common_pb2.Empty()

        return answered(context, answer)

    def close(self) -> None:
        """End all sessions and their generators."""
        for session in list(self._sessions.values()):
            with session.lock:
                self._end(session, "ended with the server")

    def _session(self, name: str) -> Session:
        with self._lock:
            session = self._sessions.get(name)
        if session is None:
            raise unknown("a session that was started here and has not ended", repr(name))
        return session

    def _started(self, request: video_model_pb2.SessionRequest) -> video_model_pb2.SessionId:
        self._end_idle()
        with self._lock:
            if len(self._sessions) + self._starting >= self._settings.sessions:
                text = f"expected at most {self._settings.sessions} sessions (--sessions), found as many that have not ended"
                raise RequestError(grpc.StatusCode.RESOURCE_EXHAUSTED, text)
            self._starting += 1
        session = None
        try:
            session = self._new(request)
        finally:
            with self._lock:
                self._starting -= 1
                if session is not None:
                    self._sessions[session.name] = session
        return video_model_pb2.SessionId(session_id=session.name)

    def _new(self, request: video_model_pb2.SessionRequest) -> Session:
        scene = self._scenes.get(_scene(request.static_world_map.hdmap_parquets, self._scenes.names))
        cameras = views(request)
        debug, name = request.debug_options, uuid.uuid4().hex
        generator = None if debug.skip_video_generation else self._generator(request, scene, cameras)
        try:
            session = Session(name, scene, cameras, generator, debug.return_hdmap_frames, self._settings)
        except BaseException:
            if generator is not None:
                generator.close()
            raise
        notes = [scene.log.name, f"{len(cameras)} cameras"]
        if generator is None:
            notes.append("no generated images (skip_video_generation)")
        elif generator.references != 1:
            notes.append(f"the generator needs {generator.references} references: first frames are given as often")
        if request.text_prompt.negative:
            notes.append("the negative prompt has no effect")
        _say(f"session {name} started: {', '.join(notes)}")
        return session

    def _generator(self, request: video_model_pb2.SessionRequest, scene: Scene, cameras: list[View]) -> Generator:
        """Return the generator of a session. Raises ``RequestError`` with ``UNAVAILABLE`` if it does not start."""
        shown = pskel.Scene(scene.first.ego, [view.camera for view in cameras], map_of=scene.first)
        try:
            made: Generator = self._settings.open(
                shown, log=scene.log.name, prompt=request.text_prompt.positive, noise_seed=request.random_seed
            )
        except ValueError as error:
            raise RequestError(grpc.StatusCode.INVALID_ARGUMENT, f"the generator takes no such session: {error}") from None
        except pskel.Error as error:
            raise RequestError(grpc.StatusCode.UNAVAILABLE, f"the generator does not start: {error}") from None
        return made

    def _end(self, session: Session, how: str) -> None:
        """Remove a session, whose lock is held, and end its generator."""
        with self._lock:
            if self._sessions.pop(session.name, None) is None:
                return
        _say(f"session {session.name} {how}: {session.summary}")
        try:
            session.close()
        except Exception as error:  # it has ended anyhow
            _say(f"session {session.name}: the generator did not end: {error}")

    def _end_idle(self) -> None:
        """End sessions without a call for too long. One with a call in progress is not idle."""
        now_s = time.monotonic()
        for session in list(self._sessions.values()):
            if session.lock.acquire(blocking=False):
                try:
                    if now_s - session.used_s > self._settings.idle_s:
                        self._end(session, f"ended after {self._settings.idle_s:g} s without a call")
                finally:
                    session.lock.release()


def _scene(parquets: bytes, names: list[str]) -> str:
    """Return the name of a session's scene: the clip of its HD map, or the only scene. Raises ``RequestError``."""
    if not parquets:
        if len(names) == 1:
            return names[0]
        text = f"expected hdmap_parquets that name one of {', '.join(names)}, found none: send them, or serve one scene per process"
        raise RequestError(grpc.StatusCode.FAILED_PRECONDITION, text)
    try:
        with zipfile.ZipFile(io.BytesIO(parquets)) as archive:
            files = [name for name in archive.namelist() if name.endswith(".parquet")]
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise invalid("hdmap_parquets as a zip", f"{len(parquets)} bytes: {error}") from None
    clips = sorted({file.removesuffix(".parquet").rpartition(".")[0] for file in files})
    if len(clips) != 1 or not clips[0]:
        raise invalid("hdmap_parquets with files CLIP.NAME.parquet of one clip", clips)
    for name in names:
        if name.removeprefix(CLIP_PREFIX) == clips[0]:
            return name
    raise unknown(f"hdmap_parquets of a scene among {', '.join(names)}", repr(clips[0]))


def _ended(cause: Exception) -> RequestError:
    """Return the error of a call that ended its session."""
    if isinstance(cause, RequestError):
        return RequestError(cause.code, f"{cause}; the session has ended")
    return RequestError(grpc.StatusCode.INTERNAL, f"the generator failed, the session has ended: {cause}")


def _say(text: str) -> None:
    print(f"pskel.serve: {' '.join(text.split())}", file=sys.stderr, flush=True)
