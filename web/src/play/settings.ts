// The rules of a player: how much it buffers, when it begins, what it may do beside fetching segment after segment.
import { SESSION } from "../generated/constants.ts";

/** Settings that cannot work, or a policy that does not exist. */
export class ConfigError extends Error {
  override name = "ConfigError";
}

type Rules = typeof SESSION;

/** The rules of airgs_codec.play.settings, which says what each is. */
export type SessionSettings = { [Name in keyof Rules]: Rules[Name] extends number ? number : boolean };

/** Settings with defaults for what is not given. Throws ConfigError for a buffer that cannot work. */
export function sessionSettings(given: Partial<SessionSettings> = {}): SessionSettings {
  const settings = { ...SESSION, ...given };
  const { bufferS } = settings;
  if (!(bufferS > 0 && bufferS < Infinity)) throw new ConfigError(`buffer: expected more than 0 s, got ${bufferS}`);
  return settings;
}
