"use strict";

// The time that all scenes show, in s of the recordings; it runs during playback.
class ReplayClock {
  constructor(changed) {
    this.changed = changed;
    this.times = new Float64Array(1);
    this.end = 0;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.last = null;
  }

  get begin() {
    return this.times[0];
  }

  // Instants to step through, and the end of the longest recording.
  setTimes(times, end) {
    this.times = times;
    this.end = Math.max(end, times[times.length - 1]);
    this.seek(this.time);
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.begin), this.end);
    this.changed();
  }

  // To the next or previous instant; from between two instants to one of them.
  step(count) {
    this.pause();
    const k = instantBefore(this.times, this.time);
    const onInstant = k >= 0 && Math.abs(this.times[k] - this.time) < 1e-6;
    const next = k + count + (count < 0 && !onInstant ? 1 : 0);
    this.seek(this.times[Math.min(Math.max(next, 0), this.times.length - 1)]);
  }

  play() {
    if (this.playing) return;
    if (this.time >= this.end - 1e-6) this.time = this.begin;
    this.playing = true;
    this.last = null;
    requestAnimationFrame((now) => this.tick(now));
    this.changed();
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.changed();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  tick(now) {
    if (!this.playing) return;
    // A page that was in the background does not jump ahead.
    const passed = this.last === null ? 0 : Math.min((now - this.last) / 1000, 0.1);
    this.last = now;
    this.time = Math.min(this.time + passed * this.speed, this.end);
    if (this.time >= this.end) this.playing = false;
    this.changed();
    if (this.playing) requestAnimationFrame((later) => this.tick(later));
  }
}
