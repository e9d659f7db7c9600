#!/usr/bin/env python3
"""A denoiser (docs/src/reference/denoiser.md) without weights: it outputs the color conditions at an eighth of their size.
Uses standard input and output (denoiser.py), or a socket named as for pskel (denoiser.py unix:PATH|tcp:HOST:PORT)."""
import array, json, pathlib, socket, struct, sys

def read(stream):  # returns texts and tensors (shape, values) of a message; None at the end
    if not (length := stream.read(8)):
        return None
    message = stream.read(*struct.unpack("<Q", length))
    start = 8 + struct.unpack_from("<Q", message)[0]
    header, data = json.loads(message[8:start]), message[start:]
    values = lambda t: array.array("f", data[slice(*t["data_offsets"])])
    return header.pop("__metadata__", {}), {name: (t["shape"], values(t)) for name, t in header.items()}


def write(stream, texts, tensors={}):  # texts and tensors (dtype, shape, bytes)
    header, data = {"__metadata__": texts}, b""
    for name, (dtype, shape, values) in tensors.items():
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [len(data), len(data) + len(values)]}
        data += values
    header = json.dumps(header).encode()
    stream.write(struct.pack("<QQ", 8 + len(header) + len(data), len(header)) + header + data)
    stream.flush()


def predict(tensors):  # the velocity `noise - clean`, where clean is the mean color of each block, -1 to 1
    (frames, views, channels, rows, columns), latents = tensors["latents"]
    ((_, _, maps, height, width), points), velocity = tensors["points"], array.array("f")
    for plane in range(frames * views * channels):
        (view, channel), sigma = divmod(plane, channels), tensors["sigmas"][1][plane // (views * channels)]
        for row in range(rows):
            top = ((view * maps + channel) * height + row * 8) * width
            for left in range(top, top + columns * 8, 8):
                mean = sum(sum(points[left + y * width : left + y * width + 8]) for y in range(8)) / 64
                velocity.append((latents[len(velocity)] - (2 * mean - 1)) / sigma)
    return velocity


def serve(source, out):
    told, hello = read(source)[0], {"protocol": "pskel-denoiser", "version": "1", "dtype": "F32"}
    if (told["sampler"], told["prediction"]) != ("flow_match", "velocity"):
        sys.exit("denoiser.py: expected flow_match with velocity, found {sampler} with {prediction}".format_map(told))
    rows, columns = (int(side) // 8 for side in told["condition_size"].split(","))
    write(out, hello | {"latent_shape": f"{told['views']},3,{rows},{columns}"})
    for texts, tensors in iter(lambda: read(source), None):
        write(out, {"call": texts["call"]}, {"prediction": ("F32", tensors["latents"][0], predict(tensors).tobytes())})


if __name__ == "__main__" and len(sys.argv) < 2:
    serve(sys.stdin.buffer, sys.stdout.buffer)
elif __name__ == "__main__":
    kind, _, where = sys.argv[1].partition(":")
    host, _, port = where.rpartition(":")
    if kind == "unix" and pathlib.Path(where).is_socket():
        pathlib.Path(where).unlink()  # left over from an earlier run
    server = socket.socket(socket.AF_UNIX) if kind == "unix" else socket.create_server((host, int(port)))
    if kind == "unix":
        server.bind(where), server.listen(1)
    with server.accept()[0].makefile("rwb") as stream:
        serve(stream, stream)
