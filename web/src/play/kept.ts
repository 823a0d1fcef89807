/** Values that are made when they are asked for; the last ones made are kept. */
export class Kept<Value, Key = number> {
  private readonly values = new Map<Key, Value>();

  constructor(private readonly most: number) {}

  get(key: Key, make: () => Value): Value {
    const found = this.values.get(key);
    if (found !== undefined) return found;
    const made = make();
    this.values.set(key, made);
    if (this.values.size > this.most) this.values.delete(this.values.keys().next().value as Key);
    return made;
  }
}
