// The page's only clock: whatever depends on the time listens to it.

export type ClockListener = (time: number) => void;

export const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4, 10];

export class Clock {
  private now: number;
  private rate = 1;
  private frame = 0;
  private last = 0;
  private readonly listeners = new Set<ClockListener>();
  private readonly stateListeners = new Set<() => void>();

  constructor(
    private first: number,
    private end: number,
    readonly tick: number,
  ) {
    this.now = first;
  }

  get time(): number {
    return this.now;
  }

  get span(): readonly [number, number] {
    return [this.first, this.end];
  }

  get playing(): boolean {
    return this.frame !== 0;
  }

  get speed(): number {
    return this.rate;
  }

  set speed(rate: number) {
    this.rate = rate;
    this.tell();
  }

  /** Move the end of a live run; the caller then seeks. */
  extend(end: number): void {
    this.end = Math.max(this.end, end);
  }

  /** Go to an instant [s], within the run. */
  seek(time: number): void {
    if (!Number.isFinite(time)) return;
    this.now = Math.min(Math.max(time, this.first), this.end);
    for (const listener of this.listeners) listener(this.now);
  }

  /** Step forward, or back, by a number of rows. */
  step(rows: number): void {
    this.pause();
    const row = Math.round((this.now - this.first) / this.tick) + rows;
    this.seek(this.first + row * this.tick);
  }

  play(): void {
    if (this.playing) return;
    if (this.now >= this.end) this.seek(this.first);
    this.last = performance.now();
    this.frame = requestAnimationFrame((stamp) => this.advance(stamp));
    this.tell();
  }

  pause(): void {
    if (!this.playing) return;
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    this.tell();
  }

  toggle(): void {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Call a listener now and at each new time. */
  onTime(listener: ClockListener): void {
    this.listeners.add(listener);
    listener(this.now);
  }

  /** Call a listener now and when the clock starts, stops, or changes speed or span. */
  onState(listener: () => void): void {
    this.stateListeners.add(listener);
    listener();
  }

  private advance(stamp: number): void {
    const passed = Math.max(stamp - this.last, 0) / 1000;
    this.last = stamp;
    this.seek(this.now + this.rate * passed);
    if (this.now >= this.end) {
      this.frame = 0;
      this.tell();
      return;
    }
    this.frame = requestAnimationFrame((next) => this.advance(next));
  }

  private tell(): void {
    for (const listener of this.stateListeners) listener();
  }
}
