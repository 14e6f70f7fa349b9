"use strict";

const ROOT5 = Math.sqrt(5);

// Predicts the score of any scenario, as the Gaussian process of `evidence/_score_surrogate.py` does.
class Predictor {
  constructor(told, parameters) {
    this.told = told;
    this.parameters = parameters;
    const { count } = told;
    // Bytes are copied, since numbers of 8 bytes have to begin at a multiple of 8.
    const read = (text, Kind) => new Kind(fromBase64(text).slice().buffer);
    this.weights = read(told.weights, Float64Array);
    this.factor = Float64Array.from(read(told.factor, told.single ? Float32Array : Float64Array));
    const points = read(told.points, Float64Array);
    const dims = told.length_scales.length;
    // For each parameter its scaled coordinates of all points: one, or one for each choice.
    let first = 0;
    this.columns = parameters.map(({ choices }) => {
      const scales = told.length_scales.slice(first, first + (choices.length || 1));
      const columns = scales.map((scale, j) =>
        Float64Array.from({ length: count }, (_, i) => points[i * dims + first + j] / scale));
      first += scales.length;
      return { scales, columns };
    });
  }

  // Scaled coordinates of a value: positions in the unit interval, or a corner of a simplex for a choice.
  encode(k, value) {
    const { scales } = this.columns[k];
    const table = this.told.positions[k];
    if (table === null) return scales.map((scale, j) => (j === value ? Math.SQRT1_2 / scale : 0));
    return [interpolated(table, value) / scales[0]];
  }

  // Squared scaled distances of all points to values of a parameter, one row of them for each value.
  distances(k, values) {
    const { count } = this.told;
    const found = new Float64Array(values.length * count);
    values.forEach((value, a) => {
      this.encode(k, value).forEach((place, j) => {
        const column = this.columns[k].columns[j];
        for (let i = 0; i < count; i++) found[a * count + i] += (column[i] - place) ** 2;
      });
    });
    return found;
  }

  // Covariances of all points with each point of a grid over the parameters x and y, others being as in `scenario`:
  // calls `use(covariances, node)` for each node, row by row of y.
  eachNode(scenario, x, xs, y, ys, use) {
    const { count, signal } = this.told;
    const others = new Float64Array(count);
    scenario.forEach((value, k) => {
      if (k === x || k === y) return;
      this.distances(k, [value]).forEach((distance, i) => (others[i] += distance));
    });
    const [across, up] = [this.distances(x, xs), this.distances(y, ys)];
    const near = new Float64Array(count);
    const covariances = new Float64Array(count);
    const variance = signal * signal;
    for (let b = 0; b < ys.length; b++) {
      for (let i = 0; i < count; i++) near[i] = others[i] + up[b * count + i];
      for (let a = 0; a < xs.length; a++) {
        const from = a * count;
        for (let i = 0; i < count; i++) {
          const far = ROOT5 * Math.sqrt(near[i] + across[from + i]);
          covariances[i] = variance * (1 + far * (1 + far / 3)) * Math.exp(-far);
        }
        use(covariances, b * xs.length + a);
      }
    }
  }

  // Predicted scores of a grid, in the unit of the score.
  scores(scenario, x, xs, y, ys) {
    const { weights } = this;
    const { count, offset, scale } = this.told;
    const found = new Float64Array(xs.length * ys.length);
    this.eachNode(scenario, x, xs, y, ys, (covariances, node) => {
      let sum = 0;
      for (let i = 0; i < count; i++) sum += covariances[i] * weights[i];
      found[node] = offset + scale * sum;
    });
    return found;
  }

  // Their standard deviations, without the noise of a single run.
  deviations(scenario, x, xs, y, ys) {
    const { count, signal, scale } = this.told;
    const found = new Float64Array(xs.length * ys.length);
    // Four nodes at a time: a sum waits for its last addition, four sums do not wait for each other.
    const four = new Float64Array(4 * count);
    this.eachNode(scenario, x, xs, y, ys, (covariances, node) => {
      const place = node % 4;
      for (let i = 0; i < count; i++) four[4 * i + place] = covariances[i];
      if (place < 3 && node < found.length - 1) return;
      const explained = this.explained(four);
      for (let k = 0; k <= place; k++) {
        const left = signal * signal - explained[k];
        found[node - place + k] = Math.abs(scale) * Math.sqrt(Math.max(left, 1e-12 * signal * signal));
      }
    });
    return found;
  }

  // Variance that the points explain, of four nodes whose covariances alternate.
  explained(four) {
    const { factor } = this;
    const { count } = this.told;
    const sums = [0, 0, 0, 0];
    for (let i = 0, at = 0; i < count; i++) {
      let [a, b, c, d] = [0, 0, 0, 0];
      for (let j = 0; j <= 4 * i; j += 4) {
        const one = factor[at++];
        a += one * four[j];
        b += one * four[j + 1];
        c += one * four[j + 2];
        d += one * four[j + 3];
      }
      sums[0] += a * a;
      sums[1] += b * b;
      sums[2] += c * c;
      sums[3] += d * d;
    }
    return sums;
  }

  // Standard deviation where nothing is known.
  get most() {
    return Math.abs(this.told.scale) * this.told.signal;
  }

  // Standard deviation of a single run around what is predicted.
  get noise() {
    return Math.abs(this.told.scale) * this.told.noise;
  }
}

// The predictor of the page; null if it has none.
function predictorOf(store) {
  const { predictor, parameters } = store.contents;
  if (!predictor) return null;
  if (store.predictor?.told !== predictor) store.predictor = new Predictor(predictor, parameters);
  return store.predictor;
}

// Linear between the values of a table, constant outside.
function interpolated([values, positions], value) {
  let k = 1;
  while (k < values.length - 1 && values[k] < value) k++;
  if (values.length < 2 || value <= values[0]) return positions[0];
  const share = Math.min(1, (value - values[k - 1]) / (values[k] - values[k - 1]));
  return positions[k - 1] + share * (positions[k] - positions[k - 1]);
}

// Probability that a normal number is below `z`, to 1.5e-7. Source: Abramowitz and Stegun (1964), 7.1.26.
function normalBelow(z) {
  const x = Math.abs(z) / Math.SQRT2;
  const t = 1 / (1 + 0.3275911 * x);
  const series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
  const above = 0.5 * series * Math.exp(-x * x);
  return z > 0 ? 1 - above : above;
}
