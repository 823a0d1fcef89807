// Programs, compiled when they are first asked for and used when they are done, so that compiling blocks nobody.
import { RenderError, type Texture } from "./textures.ts";

/** The text of a program and its samplers: the n-th has texture unit n. */
export interface Source {
  vertex: string;
  fragment: string;
  samplers: readonly string[];
}

interface Compiled {
  source: Source;
  program: WebGLProgram;
  shaders: WebGLShader[];
  uniforms: Map<string, WebGLUniformLocation> | null;
}

export type Uniforms = (name: string) => WebGLUniformLocation | null;

export class Programs {
  readonly #parallel: KHR_parallel_shader_compile | null;
  readonly #made = new Map<string, Compiled>();

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.#parallel = gl.getExtension("KHR_parallel_shader_compile");
  }

  prepare(name: string, source: () => Source): void {
    if (this.#made.has(name)) return;
    const gl = this.gl;
    const text = source();
    const program = gl.createProgram();
    const shaders = [text.vertex, text.fragment].map((code, i) => {
      const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER)!;
      gl.shaderSource(shader, code);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      return shader;
    });
    gl.linkProgram(program);
    this.#made.set(name, { source: text, program, shaders, uniforms: null });
  }

  /** Whether using these programs waits for no compiler; where the browser cannot say, it is done by asking. */
  done(names: readonly string[]): boolean {
    return names.every((name) => {
      const made = this.#made.get(name);
      if (!made) return false;
      if (made.uniforms || !this.#parallel) return true;
      return this.gl.getProgramParameter(made.program, this.#parallel.COMPLETION_STATUS_KHR) === true;
    });
  }

  /** Uses a program with textures in the order of its samplers. Throws RenderError if it does not compile. */
  use(name: string, textures: readonly Texture[]): Uniforms {
    const gl = this.gl;
    const made = this.#made.get(name)!;
    gl.useProgram(made.program);
    made.uniforms ??= this.#link(name, made);
    textures.forEach(({ target, handle }, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, handle);
    });
    const { uniforms } = made;
    return (uniform) => uniforms.get(uniform) ?? null;
  }

  free(): void {
    for (const { program } of this.#made.values()) this.gl.deleteProgram(program);
    this.#made.clear();
  }

  #link(name: string, { program, shaders, source }: Compiled): Map<string, WebGLUniformLocation> {
    const gl = this.gl;
    const uniforms = new Map<string, WebGLUniformLocation>();
    if (gl.getProgramParameter(program, gl.LINK_STATUS) !== true && !gl.isContextLost()) {
      const words = [...shaders.map((shader) => gl.getShaderInfoLog(shader)), gl.getProgramInfoLog(program)];
      throw new RenderError(`${name}: expected a program that compiles, got ${words.filter(Boolean).join("; ")}`);
    }
    for (const shader of shaders) gl.deleteShader(shader);
    const count: number = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) ?? 0;
    for (let i = 0; i < count; i++) {
      const uniform = gl.getActiveUniform(program, i)?.name ?? "";
      const at = gl.getUniformLocation(program, uniform);
      if (at) uniforms.set(uniform.replace("[0]", ""), at);
    }
    source.samplers.forEach((sampler, unit) => {
      gl.uniform1i(uniforms.get(sampler) ?? null, unit);
    });
    return uniforms;
  }
}
