#!/usr/bin/env python3
"""A planner for `pskel simulate`: follows the recorded path and stops for what is on it. See docs/PLANNER.md.

Over standard input and output: planner.py; at a socket: planner.py unix:PATH or planner.py tcp:PORT.
"""
import json
import math
import socket
import sys


def plan(see):
    ego, path = see["ego"], see["path"] or [[see["ego"]["x"], see["ego"]["y"]]]
    ahead = lambda a: (a["x"] - ego["x"]) * math.cos(ego["heading"]) + (a["y"] - ego["y"]) * math.sin(ego["heading"])
    on_path = lambda a: min(math.dist(p, (a["x"], a["y"])) for p in path) < 1.2 + a["width"] / 2
    gaps = [ahead(a) - a["length"] / 2 - 5.0 for a in see["actors"] if ahead(a) > 4 and on_path(a)]
    limit = math.sqrt(2 * 2.0 * max(min(gaps, default=100.0) - 2.0, 0.0))  # brakes with 2 m/s^2, 2 m before it
    x, y, heading, v, trajectory = ego["x"], ego["y"], ego["heading"], max(ego["v"], 0.0), []
    for i in range(1, 31):
        v = min(v + 0.1, 8.0, limit) if limit > v else max(v - 0.3, limit, 0.0)
        far = [p for p in path if math.dist(p, (x, y)) > 4.0 + 0.5 * v] or [[x + math.cos(heading), y + math.sin(heading)]]
        turn = math.remainder(math.atan2(far[0][1] - y, far[0][0] - x) - heading, math.tau)
        heading += max(-0.3, min(0.3, turn)) * min(v * 0.1 / 3.0, 1.0)
        x, y = x + v * 0.1 * math.cos(heading), y + v * 0.1 * math.sin(heading)
        trajectory.append({"t": i / 10, "x": x, "y": y, "heading": heading, "v": v})
    return {"step": see["step"], "trajectory": trajectory}


def serve(lines, out):
    for line in lines:
        message = json.loads(line)
        hello = {"protocol": "pskel-planner", "version": 1}
        print(json.dumps(plan(message) if message.get("type") == "observation" else hello), file=out, flush=True)


if len(sys.argv) < 2:
    serve(sys.stdin, sys.stdout)
else:
    kind, _, where = sys.argv[1].partition(":")
    server = socket.socket(socket.AF_UNIX if kind == "unix" else socket.AF_INET)
    server.bind(where if kind == "unix" else ("127.0.0.1", int(where)))
    server.listen(1)
    with server.accept()[0].makefile("rw") as stream:
        serve(stream, stream)
