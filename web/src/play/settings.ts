// The rules of a player: how much it buffers, when it begins, what it may do beside fetching segment after segment.
import { SESSION, VIEW_BUFFER_S } from "../generated/constants.ts";

/** Settings that cannot work, or a policy that does not exist. */
export class ConfigError extends Error {
  override name = "ConfigError";
}

type Rules = typeof SESSION;

/** The rules of airgs_codec.play.settings, which says what each is. */
export interface SessionSettings
  extends Record<KeysOf<Rules, number>, number>,
    Record<KeysOf<Rules, boolean>, boolean> {
  /** Two segments fit the buffer, however long they are: the next one is fetched while one is shown. */
  roomForTwo: boolean;
}

type KeysOf<Fields, Kind> = { [Name in keyof Fields]: Fields[Name] extends Kind ? Name : never }[keyof Fields];

/** The rules where tiles are fetched by view: what is buffered is soon shown, and not replaced. */
export const byView = (settings: SessionSettings): SessionSettings => ({
  ...settings,
  bufferS: Math.min(settings.bufferS, VIEW_BUFFER_S),
  roomForTwo: true,
  replace: false,
});

/** Settings with defaults for what is not given. Throws ConfigError for a buffer that cannot work. */
export function sessionSettings(given: Partial<SessionSettings> = {}): SessionSettings {
  const settings = { ...SESSION, roomForTwo: false, ...given };
  const { bufferS } = settings;
  if (!(bufferS > 0 && bufferS < Infinity)) throw new ConfigError(`buffer: expected more than 0 s, got ${bufferS}`);
  return settings;
}
