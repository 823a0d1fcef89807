// The rules of a player: how much it buffers, when it begins, what it may do beside fetching segment after segment.
import { SESSION, VIEW_BUFFER_S } from "../generated/constants.ts";

/** Settings that cannot work, or a policy that does not exist. */
export class ConfigError extends Error {
  override name = "ConfigError";
}

export interface SessionSettings {
  /** Most media time ahead of the playhead, seconds. */
  bufferS: number;
  /** Two segments fit the buffer, however long they are: the next one is fetched while one is shown. */
  roomForTwo: boolean;
  /** Media time to buffer before playing begins, seconds; one segment at least. */
  startupS: number;
  /** Media time to buffer before playing goes on after a stall, seconds. */
  resumeS: number;
  /** Time to decode and apply one frame, seconds. */
  decodeFrameS: number;
  /** Fetch better rungs for segments that are buffered. */
  replace: boolean;
  /** Give up a download that would come too late. */
  abandon: boolean;
  /** Request a segment one round trip before the current batch ends, where the downloader can. */
  pipelined: boolean;
  /** Times the sequence is played, Infinity: for ever; null: for about 30 s. */
  loops: number | null;
}

/** The rules where tiles are fetched by view: what is buffered is soon shown, and not replaced. */
export const byView = (settings: SessionSettings): SessionSettings => ({
  ...settings,
  bufferS: Math.min(settings.bufferS, VIEW_BUFFER_S),
  roomForTwo: true,
  replace: false,
});

const DEFAULTS: SessionSettings = { ...SESSION, roomForTwo: false };

/** Settings with defaults for what is not given. Throws ConfigError for rules that cannot work. */
export function sessionSettings(given: Partial<SessionSettings> = {}): SessionSettings {
  const settings = { ...DEFAULTS, ...given };
  const { bufferS, startupS, resumeS, decodeFrameS, loops } = settings;
  if (!(bufferS > 0 && bufferS < Infinity)) throw new ConfigError(`buffer: expected more than 0 s, got ${bufferS}`);
  const waits = { "start-up": startupS, resume: resumeS, decoding: decodeFrameS };
  for (const [name, value] of Object.entries(waits)) {
    if (!(value >= 0 && value < Infinity)) throw new ConfigError(`${name}: expected 0 s or more, got ${value}`);
  }
  if (loops !== null && !(loops >= 1)) throw new ConfigError(`loops: expected at least 1, got ${loops}`);
  return settings;
}
