declare module "*.css" {
  const text: string;
  export default text;
}

/** A script that scripts/bundle.mjs puts into the bundle: `start` runs it as a worker. */
declare module "worker:*" {
  export function start(): Worker;
}
