// Decodes hierax messages and values with @msgpack/msgpack, from the documented format only.
//
// usage: node decode.mjs MODULE FILE...     MODULE: path of @msgpack/msgpack
// prints one line of JSON for each file, tagged as tests/support/tagged.py describes.

import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [modulePath, ...files] = process.argv.slice(2);
const { decode, ExtensionCodec } = createRequire(import.meta.url)(modulePath);

const FIELDS = 12;
const ARRAY = 1;
const TAIL_ARRAY = 2;
const ITEM_BYTES = {
  "|b1": 1, "|i1": 1, "|u1": 1, "<i2": 2, "<u2": 2, "<i4": 4, "<u4": 4, "<i8": 8, "<u8": 8,
  "<f2": 2, "<f4": 4, "<f8": 8, "<c8": 8, "<c16": 16,
};
const KINDS = ["obs", "task", "ctx", "hello"];

class NumericArray {
  constructor(data) {
    const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    const ndim = view.getUint8(0);
    const nameLength = view.getUint8(1);
    const padding = view.getUint16(2, true);
    this.dtype = Buffer.from(data.subarray(4, 4 + nameLength)).toString("ascii");
    this.shape = Array.from({ length: ndim }, (_, i) => Number(view.getBigUint64(4 + nameLength + 8 * i, true)));
    const start = 4 + nameLength + 8 * ndim + padding;
    this.elements = data.subarray(start);
    const count = this.shape.reduce((product, side) => product * side, 1);
    if (this.elements.length !== count * ITEM_BYTES[this.dtype]) {
      throw new Error(`${this.dtype} ${this.shape}: ${this.elements.length} bytes`);
    }
  }
}

class TailReference {
  constructor(data) {
    this.index = new DataView(data.buffer, data.byteOffset, data.byteLength).getUint16(0);
  }
}

const extensionCodec = new ExtensionCodec();
for (const [type, Kind] of [[ARRAY, NumericArray], [TAIL_ARRAY, TailReference]]) {
  extensionCodec.register({ type, encode: () => null, decode: (data) => new Kind(data) });
}

function digested(bytes) {
  const buffer = Buffer.from(bytes);
  return buffer.length <= 64 ? buffer.toString("hex") : "sha256:" + createHash("sha256").update(buffer).digest("hex");
}

function tagged(value, tail) {
  if (value instanceof TailReference) return tagged(tail[value.index], tail);
  if (value instanceof NumericArray) return { $array: [value.dtype, value.shape, digested(value.elements)] };
  if (value instanceof Uint8Array) return { $bytes: digested(value) };
  if (Array.isArray(value)) return value.map((part) => tagged(part, tail));
  if (typeof value === "bigint") {
    const safe = value > -(2n ** 53n) && value < 2n ** 53n;
    return safe ? Number(value) : { $int: value.toString() };
  }
  if (typeof value === "number" && !Number.isFinite(value)) {
    return { $float: Number.isNaN(value) ? "nan" : value > 0 ? "inf" : "-inf" };
  }
  if (value !== null && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, part]) => [key, tagged(part, tail)]));
  }
  return value;
}

function messageOf(fields) {
  const tail = fields.slice(FIELDS, -1);
  const [format, kind, sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions, payload] = fields;
  if (format !== 1) throw new Error(`format ${format}`);
  const header = {
    kind: KINDS[kind], sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions,
  };
  return { header: tagged(header, tail), payload: tagged(payload, tail) };
}

for (const file of files) {
  const value = decode(readFileSync(file), { extensionCodec, useBigInt64: true });
  console.log(JSON.stringify(file.includes("message-") ? messageOf(value) : tagged(value, [])));
}
