// Mixing with WebGL2: layers as arrays of half-float textures, one shader with the project's tone curve.
import type { ObjectLayers, View } from "./data";
import { CURVES, LIT, type Pane } from "./state";
import { STOPS } from "./light";
import type { Lit, Painter } from "./paint";

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3. : -1., gl_VertexID == 2 ? 3. : -1., 0., 1.); }`;
const FRAGMENT = (lights: number): string => `#version 300 es
precision highp float; precision highp int; precision highp sampler2DArray; precision highp sampler2D;
uniform sampler2DArray layers, without, foreground;
uniform sampler2D coverage;
uniform vec3 base[${lights}], insert[${lights}];
uniform ivec4 box;
uniform int pane, curve;
out vec4 colour;
vec3 mixed(sampler2DArray stack, ivec2 at, vec3 gains[${lights}]) {
  vec3 sum = vec3(0);
  for (int i = 0; i < ${lights}; i++) if (gains[i] != vec3(0)) sum += gains[i] * texelFetch(stack, ivec3(at, i), 0).rgb;
  return sum;
}
vec3 pasted(ivec2 at) {
  vec3 behind = mixed(without, at, base);
  ivec2 own = at - box.xy;
  if (any(lessThan(own, ivec2(0))) || any(greaterThanEqual(own, box.zw))) return behind;
  return mixed(foreground, own, insert) + (1. - texelFetch(coverage, own, 0).r) * behind;
}
vec3 soft(vec3 rgb) {
  float peak = max(rgb.r, max(rgb.g, rgb.b));
  if (peak <= .6) return rgb;
  float top = 1. - .16 / (peak + .4 - .6), kept = 1. / (.15 * (peak - top) + 1.);
  return rgb * (top / peak) * kept + top * (1. - kept);
}
vec3 encoded(vec3 x) {
  x = clamp(x, 0., 1.);
  return mix(1.055 * pow(max(x, .0031308), vec3(1. / 2.4)) - .055, 12.92 * x, lessThanEqual(x, vec3(.0031308)));
}
const vec3 STOPS[13] = vec3[](${STOPS.map((rgb) => `vec3(${rgb.join(", ")})`).join(", ")});
void main() {
  ivec2 size = textureSize(layers, 0).xy, at = ivec2(gl_FragCoord.xy);
  at.y = size.y - 1 - at.y;
  colour.a = 1.;
  if (pane == 3) { colour.rgb = tanh(clamp(1.5 * (mixed(layers, at, base) - mixed(without, at, base)), -9., 9.)) * .5 + .5; return; }
  vec3 rgb = max(pane == 0 ? mixed(without, at, base) : pane == 1 ? pasted(at) : mixed(layers, at, base), 0.);
  if (curve == 2) {
    float stop = log2(max(dot(rgb, vec3(.2126, .7152, .0722)), 1e-9) / .18);
    colour.rgb = STOPS[int(clamp(floor(stop + .5), -6., 6.)) + 6] / 255.;
  } else colour.rgb = encoded(curve == 0 ? soft(min(rgb, 1e6)) : rgb);
}`;
/** Uniforms of a fragment shader that every WebGL2 has, less a few. */
const MOST_LIGHTS = 100;
const NAMES = ["layers", "without", "foreground", "coverage", "base", "insert", "box", "pane", "curve"] as const;

export class GpuPainter implements Painter {
  private readonly canvas = document.createElement("canvas");
  private readonly gl: WebGL2RenderingContext;
  private places: Record<string, WebGLUniformLocation | null> = {};
  private readonly textures = new Map<string, WebGLTexture>();
  private lights = 0;
  private held: { view?: View; object?: ObjectLayers } = {};

  /** Throws where there is no WebGL2; `lost` is called when the graphics card is taken away. */
  constructor(lost: () => void) {
    const gl = this.canvas.getContext("webgl2", { antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("no WebGL2");
    this.gl = gl;
    this.canvas.addEventListener("webglcontextlost", lost);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  }

  take(view: View, name: string): void {
    const object = view.objects.get(name) as ObjectLayers;
    const { width, height, scale } = view.about;
    const { gl } = this;
    if (scale.length > MOST_LIGHTS || Math.max(width, height) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("too large");
    this.build(scale.length);
    if (this.held.view !== view) this.stack("layers", view.all, width, height);
    if (this.held.object !== object) {
      const [, , wide, high] = object.box;
      this.stack("without", object.without, width, height);
      this.stack("foreground", object.foreground, wide, high);
      this.bind("coverage", gl.TEXTURE_2D);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16F, wide, high, 0, gl.RED, gl.HALF_FLOAT, object.coverage);
      gl.uniform4iv(this.places.box, object.box);
    }
    this.held = { view, object };
    if (gl.getError()) throw new Error("the graphics card refuses the layers");
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    gl.viewport(0, 0, width, height);
  }

  paint(pane: Pane, lit: Lit): CanvasImageSource {
    const { gl, places } = this;
    gl.uniform3fv(places.base, lit.base);
    gl.uniform3fv(places.insert, lit.insert);
    gl.uniform1i(places.pane, (LIT as readonly Pane[]).indexOf(pane));
    gl.uniform1i(places.curve, CURVES.indexOf(lit.curve));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return this.canvas;
  }

  /** Compile the shader for a number of lights. */
  private build(lights: number): void {
    if (lights === this.lights) return;
    const { gl } = this;
    const program = gl.createProgram() as WebGLProgram;
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT(lights)]] as const) {
      const shader = gl.createShader(kind) as WebGLShader;
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error("the shader cannot be used here");
    gl.useProgram(program);
    this.places = Object.fromEntries(NAMES.map((name) => [name, gl.getUniformLocation(program, name)]));
    NAMES.slice(0, 4).forEach((name, unit) => gl.uniform1i(this.places[name], unit));
    this.lights = lights;
    this.held = {};
  }

  private stack(name: string, values: Uint16Array, width: number, height: number): void {
    const { gl } = this;
    this.bind(name, gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGB16F, width, height, this.lights, 0, gl.RGB, gl.HALF_FLOAT, values);
  }

  /** Make the texture of a name the one that is filled, in its own unit. */
  private bind(name: (typeof NAMES)[number] | string, kind: number): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + NAMES.indexOf(name as (typeof NAMES)[number]));
    const texture = this.textures.get(name) ?? (gl.createTexture() as WebGLTexture);
    this.textures.set(name, texture);
    gl.bindTexture(kind, texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, filter, gl.NEAREST);
  }
}
