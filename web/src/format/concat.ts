/** Arrays of a kind one after another. */
export function concat<T extends Uint8Array | Float32Array>(parts: readonly T[], kind: new (length: number) => T): T {
  const whole = new kind(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
