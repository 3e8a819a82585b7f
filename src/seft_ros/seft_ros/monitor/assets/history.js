// What the test has done so far, as the monitor keeps it: the last stretch sample by sample, the
// whole as smallest and largest values of equal pieces.

const LENGTH = 2 ** 15;
const BUCKETS = 4096;
const HEADER = 32;
export const SAMPLES = 0, ENVELOPE = 1, RECENT = 2;

/** Read a frame: kind, test, columns, count, first (step), size (steps), values. */
export function readFrame(buffer) {
  const view = new DataView(buffer);
  const [kind, test, columns, count] = [0, 4, 8, 12].map((at) => view.getUint32(at, true));
  const [first, size] = [16, 24].map((at) => view.getFloat64(at, true));
  return { kind, test, columns, count, first, size, values: new Float32Array(buffer, HEADER) };
}

const arrays = (columns, length) =>
  Array.from({ length: columns }, () => new Float32Array(length).fill(NaN));

export class History {
  constructor(test, columns) {
    this.test = test;
    this.columns = columns;
    this.ring = arrays(columns, LENGTH);
    this.low = arrays(columns, BUCKETS);
    this.high = arrays(columns, BUCKETS);
    this.first = this.head = 0; // of what the ring holds
    this.origin = this.count = 0;
    this.size = 1;
  }

  /** Step of the first sample of the test that was seen. */
  get begin() {
    return this.count ? this.origin : this.first;
  }

  take(frame) {
    const { kind, count, values } = frame;
    if (kind === ENVELOPE) {
      [this.origin, this.count, this.size] = [frame.first, count, frame.size];
      for (let column = 0; column < this.columns; column++) {
        this.low[column].fill(NaN).set(values.subarray(column * count, (column + 1) * count));
        const from = (this.columns + column) * count;
        this.high[column].fill(NaN).set(values.subarray(from, from + count));
      }
      return;
    }
    this.keep(frame);
    if (kind === SAMPLES) this.fold(frame);
  }

  keep({ kind, first, count, values }) {
    if (kind === RECENT || first < this.head || first > this.head + LENGTH || !this.head)
      this.first = this.head = first;
    for (; this.head < first; this.head++)
      for (const ring of this.ring) ring[this.head % LENGTH] = NaN;
    for (let column = 0; column < this.columns; column++)
      for (let at = 0; at < count; at++)
        this.ring[column][(first + at) % LENGTH] = values[column * count + at];
    this.head = first + count;
    this.first = Math.max(this.first, this.head - LENGTH);
  }

  fold({ first, count, values }) {
    if (!this.count) this.origin = first;
    while (Math.floor((first + count - 1 - this.origin) / this.size) >= BUCKETS) this.halve();
    for (let column = 0; column < this.columns; column++) {
      const low = this.low[column], high = this.high[column];
      for (let at = 0; at < count; at++) {
        const value = values[column * count + at];
        const bucket = Math.floor((first + at - this.origin) / this.size);
        if (!(low[bucket] <= value)) low[bucket] = Number.isNaN(value) ? low[bucket] : value;
        if (!(high[bucket] >= value)) high[bucket] = Number.isNaN(value) ? high[bucket] : value;
      }
    }
    this.count = Math.floor((first + count - 1 - this.origin) / this.size) + 1;
  }

  halve() {
    const merge = (values, choose) => {
      for (let at = 0; at < BUCKETS; at += 2) {
        const [one, other] = [values[at], values[at + 1]];
        values[at / 2] =
          Number.isNaN(one) ? other : Number.isNaN(other) ? one : choose(one, other);
      }
      values.fill(NaN, BUCKETS / 2);
    };
    for (let column = 0; column < this.columns; column++) {
      merge(this.low[column], Math.min);
      merge(this.high[column], Math.max);
    }
    this.size *= 2;
    this.count = Math.ceil(this.count / 2);
  }

  /** Points of a signal between two steps, at most two for each of some pieces: steps, values. */
  points(column, from, to, pieces) {
    const fine = from >= this.first || this.first === this.begin;
    const size = fine ? 1 : this.size, origin = fine ? 0 : this.origin;
    const end = fine ? this.head : this.origin + this.count * this.size;
    from = Math.max(from, fine ? this.first : this.origin);
    to = Math.min(to, end - 1);
    const x = [], y = [];
    if (!(to >= from)) return { x, y };
    const together = Math.max(1, Math.ceil((to - from) / size / pieces));
    const span = together * size; // pieces stand still while the window moves on
    const start = origin + Math.floor((from - origin) / span) * span;
    const low = fine ? this.ring[column] : this.low[column];
    const high = fine ? low : this.high[column];
    for (let piece = start; piece <= to; piece += span) {
      let least = Infinity, most = -Infinity, trough = piece, peak = piece;
      for (let step = Math.max(piece, from); step < piece + span && step <= to; step += size) {
        const at = fine ? step % LENGTH : Math.floor((step - origin) / size);
        const middle = step + (size - 1) / 2;
        if (low[at] < least) [least, trough] = [low[at], middle];
        if (high[at] > most) [most, peak] = [high[at], middle];
      }
      if (least > most) {
        x.push(piece + (span - 1) / 2);
        y.push(NaN);
      } else if (span === 1) {
        x.push(piece);
        y.push(least);
      } else if (trough < peak) {
        x.push(trough, peak);
        y.push(least, most);
      } else {
        x.push(peak, trough);
        y.push(most, least);
      }
    }
    return { x, y };
  }
}
