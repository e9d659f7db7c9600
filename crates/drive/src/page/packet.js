// Binary messages: length of the header, header as JSON, images.

/** Splits a message into its header and `{camera, map, width, height, type, bytes}` per image. */
export function parsePacket(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  const images = (header.images ?? []).map(({ camera, map, codec, bytes, width, height }) => {
    const data = new Uint8Array(buffer, at, bytes);
    at += bytes;
    return { camera, map, width, height, type: codec === "png" ? "image/png" : "image/jpeg", bytes: data };
  });
  return { header, images };
}
