#!/usr/bin/env python3
"""A planner for `pskel simulate` (docs/src/reference/planner.md): follows the recorded path, stops for actors on it and at its end.
Uses standard input and output (planner.py), or a socket named as for --planner (planner.py unix:PATH|tcp:HOST:PORT)."""
import json
import math
import pathlib
import socket
import sys


def plan(see):
    ego, path = see["ego"], see["path"]
    ahead = lambda a: (a["x"] - ego["x"]) * math.cos(ego["heading"]) + (a["y"] - ego["y"]) * math.sin(ego["heading"])
    on_path = lambda a: min((math.dist(p, (a["x"], a["y"])) for p in path), default=math.inf) < 1.2 + a["width"] / 2
    gaps = [ahead(a) - a["length"] / 2 - 7.0 for a in see["actors"] if ahead(a) > 4 and on_path(a)]
    room = min([sum(map(math.dist, path, path[1:])), *gaps])  # to the path's end, or until 7 m before an actor on it
    x, y, heading, v, way, trajectory = ego["x"], ego["y"], ego["heading"], max(ego["v"], 0.0), 0.0, []
    for i in range(1, 31):
        limit = min(8.0, math.sqrt(2 * 2.0 * max(room - way, 0.0)))  # brakes at 2 m/s^2
        v = min(v + 0.1, limit) if limit > v else max(v - 0.3, limit)
        while path and math.dist(path[0], (x, y)) < 4.0 + 0.5 * v or len(path) == 1:
            path = path[1:]  # skips near points; past the end of the path it goes straight
        turn = math.remainder(math.atan2(path[0][1] - y, path[0][0] - x) - heading, math.tau) if path else 0.0
        heading += max(-0.3, min(0.3, turn)) * min(v * 0.1 / 3.0, 1.0)
        x, y, way = x + v * 0.1 * math.cos(heading), y + v * 0.1 * math.sin(heading), way + v * 0.1
        trajectory.append({"t": i / 10, "x": x, "y": y, "heading": heading, "v": v})
    return {"step": see["step"], "trajectory": trajectory}


def serve(lines, out):
    for message in map(json.loads, lines):
        answer = plan(message) if message.get("type") == "observation" else {"protocol": "pskel-planner", "version": 1}
        print(json.dumps(answer), file=out, flush=True)


if len(sys.argv) < 2:
    serve(sys.stdin, sys.stdout)
else:
    kind, _, where = sys.argv[1].partition(":")
    if kind == "unix":
        if pathlib.Path(where).is_socket():
            pathlib.Path(where).unlink()  # left over from an earlier run
        server = socket.socket(socket.AF_UNIX)
        server.bind(where)
        server.listen(1)
    else:
        host, _, port = where.rpartition(":")
        server = socket.create_server((host, int(port)))
    with server.accept()[0].makefile("rw") as stream:
        serve(stream, stream)
