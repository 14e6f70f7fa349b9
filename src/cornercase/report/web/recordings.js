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

// Decodes a recording of the page's record format: arrays by name, one row per entity.
function readRecord(bytes, offset = 0) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const headLength = view.getUint32(offset, true);
  const body = offset + 4 + headLength;
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(offset + 4, body)));
  const rows = head.fields.reduce((sum, [, count]) => sum + count, 0);
  const instants = head.instants;
  const numbers = body + rows * instants;
  const recording = { ...head, courses: {} };
  let row = 0;
  for (const [name, count, step] of head.fields) {
    const origin = head.origin[name] ?? 0;
    const found = [];
    for (let k = 0; k < count; k++, row++) {
      const values = new Float64Array(instants);
      let rate = 0;
      let value = 0;
      for (let t = 0; t < instants; t++) {
        rate = (rate + view.getInt32(numbers + 4 * (row * instants + t), true)) | 0;
        value = (value + rate) | 0;
        values[t] = bytes[body + row * instants + t] ? value * step + origin : NaN;
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
  constructor(index) {
    this.index = index;
    this.blocks = new Map();
  }

  has(id) {
    return String(id) in this.index;
  }

  // A promise of the recording, or of null if the file does not contain it.
  async get(id) {
    if (!this.has(id)) return null;
    const [block, offset] = this.index[String(id)];
    if (!this.blocks.has(block)) {
      const text = document.querySelector(`script.recordings[data-block="${block}"]`).textContent;
      this.blocks.set(block, unpack(text));
    }
    return readRecord(await this.blocks.get(block), offset);
  }
}
