"use strict";

// Each style is drawn once as pixels and then copied: thousands of paths or images would take several frames.
class Stamps {
  constructor() {
    this.made = new Map();
  }

  // Looked up by the style object first: building a key for thousands of points would take longer than copying.
  get(style, r, ratio) {
    const last = style.stamp;
    if (last !== undefined && last.r === r && last.ratio === ratio) return last;
    const key = `${style.colour} ${style.symbol} ${r} ${ratio}`;
    if (!this.made.has(key)) {
      if (this.made.size > 500) this.made.clear();
      this.made.set(key, this.make(style, r, ratio));
    }
    style.stamp = this.made.get(key);
    return style.stamp;
  }

  make(style, r, ratio) {
    const canvas = document.createElement("canvas");
    const size = Math.ceil((3 * r + 2) * ratio);
    canvas.width = canvas.height = size;
    const g = canvas.getContext("2d", { willReadFrequently: true });
    g.scale(ratio, ratio);
    const middle = size / ratio / 2;
    drawSymbol(g, style, middle, middle, r);
    const pixels = new Uint32Array(g.getImageData(0, 0, size, size).data.buffer);
    return { r, ratio, size, pixels };
  }
}

const STAMPS = new Stamps();

// A pixel buffer that stamps are copied to, and that is drawn at once.
class Raster {
  begin(width, height) {
    if (this.width !== width || this.height !== height) {
      this.width = width;
      this.height = height;
      this.canvas = document.createElement("canvas");
      this.canvas.width = width;
      this.canvas.height = height;
      this.image = new ImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }
    this.pixels.fill(0);
  }

  // The centre of the stamp is at x, y.
  put({ size, pixels }, x, y) {
    const left = Math.round(x - size / 2);
    const top = Math.round(y - size / 2);
    const first = Math.max(0, -left);
    const last = Math.min(size, this.width - left);
    for (let j = Math.max(0, -top); j < Math.min(size, this.height - top); j++) {
      const to = (top + j) * this.width + left;
      for (let i = first; i < last; i++) {
        const pixel = pixels[j * size + i];
        const alpha = pixel >>> 24;
        if (alpha === 0) continue;
        const before = this.pixels[to + i];
        this.pixels[to + i] = alpha === 255 || before >>> 24 === 0 ? pixel : blend(pixel, alpha, before);
      }
    }
  }

  end(g) {
    this.canvas.getContext("2d").putImageData(this.image, 0, 0);
    g.save();
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.drawImage(this.canvas, 0, 0);
    g.restore();
  }
}

function blend(above, alpha, below) {
  let mixed = 0;
  for (let shift = 0; shift < 24; shift += 8) {
    const [one, other] = [(above >>> shift) & 255, (below >>> shift) & 255];
    mixed |= Math.round((one * alpha + other * (255 - alpha)) / 255) << shift;
  }
  return (mixed | (Math.max(alpha, below >>> 24) << 24)) >>> 0;
}
