"use strict";

// The browser's own function if it has one, else a loop: Uint8Array.from takes half a second for a large page.
function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k++) bytes[k] = letters.charCodeAt(k);
  return bytes;
}

// Bytes of a text in base64, compressed by zlib.
async function unpack(text) {
  return inflate(fromBase64(text));
}

async function inflate(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Decodes a recording that `recordings/_compact_encoding.py` encoded: arrays by name, one row per entity.
function readRecord(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const body = 4 + view.getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, body)));
  const rows = head.fields.reduce((sum, [, count]) => sum + count, 0);
  const instants = head.instants;
  const starts = body + (head.gaps ? rows * instants : 0);
  const rates = starts + 4 * rows;
  let at = rates + (instants > 1 ? 4 * rows : 0);
  const recording = { ...head, courses: {} };
  let row = 0;
  for (const [name, count, step, width] of head.fields) {
    const origin = head.origin[name] ?? 0;
    const change = { 1: "getInt8", 2: "getInt16", 4: "getInt32" }[width];
    const found = [];
    for (let k = 0; k < count; k++, row++) {
      const values = new Float64Array(instants);
      let value = view.getInt32(starts + 4 * row, true);
      let rate = instants > 1 ? view.getInt32(rates + 4 * row, true) : 0;
      for (let t = 0; t < instants; t++) {
        if (t > 1) {
          rate = (rate + view[change](at, true)) | 0;
          at += width;
        }
        if (t > 0) value = (value + rate) | 0;
        const isPresent = !head.gaps || bytes[body + row * instants + t];
        values[t] = isPresent ? value * step + origin : NaN;
      }
      found.push(values);
    }
    if (name === "time") recording.time = found[0];
    else if (name.startsWith("course ")) recording.courses[name.slice(7)] = found[0];
    else recording[name] = found;
  }
  return recording;
}

// Recordings of the file, unpacked on demand.
class EmbeddedRecordings {
  constructor(ids) {
    this.ids = new Set(ids);
  }

  has(id) {
    return this.ids.has(Number(id));
  }

  // A promise of the recording, or of null if the file does not contain it.
  async get(id) {
    if (!this.has(id)) return null;
    return readRecord(await unpack(document.querySelector(`script.recordings[data-id="${id}"]`).textContent));
  }
}
