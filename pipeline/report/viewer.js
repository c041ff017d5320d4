// The page's viewer: turns the asset and its light, one explanation at a time. Data: viewer.py.
//
// It shades by the split sum (posterior/illumination/split_sum.py, after Karis 2013):
//   L = a (1 - m) E(n) / pi + (F0 A + B) P(r, reflected),   F0 = f (1 - m) + a m
// with base colour a, metallic m, roughness r, irradiance E, light P prefiltered for each roughness,
// the facets' albedo A and B, and f what a dielectric reflects head-on.
"use strict";
(function () {
const data = JSON.parse(document.getElementById("viewer-data").textContent);
const canvas = document.getElementById("viewer");
const gl = canvas.getContext("webgl2", { alpha: true, antialias: true });
if (!gl) {
  document.getElementById("viewer-none").hidden = false;
  return;
}

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const as = (kind, text) => new kind(bytes(text).buffer);

const VERTEX = `#version 300 es
in vec3 position, normal;
in vec2 uv;
uniform mat4 camera;
uniform vec3 low, size;
out vec3 at, n;
out vec2 st;
void main() {
  at = low + size * position;
  n = normal;
  st = uv;
  gl_Position = camera * vec4(at, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DArray;
in vec3 at, n;
in vec2 st;
uniform sampler2D color, gloss, albedo;
uniform sampler2DArray light;
uniform vec3 eye;
uniform float dielectric, turned, smoothest, roughest, levels;
out vec4 shown;
const float PI = 3.14159265;

vec3 lit(vec3 d, float level) {  // of a light turned about the vertical axis
  float u = 0.5 - (atan(d.x, d.z) + turned) / (2.0 * PI);
  float v = 0.5 - asin(clamp(d.y, -1.0, 1.0)) / PI;
  return textureLod(light, vec3(u, v, level), 0.0).rgb;
}

void main() {
  vec3 a = texture(color, st).rgb;
  vec2 rm = texture(gloss, st).rg;
  vec3 out_ = normalize(eye - at);
  vec3 normal = normalize(n);
  if (dot(normal, out_) < 0.0) normal = -normal;
  float cosine = clamp(dot(normal, out_), 0.0, 1.0);
  vec3 reflected = reflect(-out_, normal);

  float place = clamp((rm.r - smoothest) / (roughest - smoothest), 0.0, 1.0) * (levels - 1.0);
  float below = min(floor(place), levels - 2.0);
  vec3 mirrored = mix(lit(reflected, below), lit(reflected, below + 1.0), place - below);
  vec2 size = vec2(textureSize(albedo, 0));
  vec2 ab = texture(albedo, (vec2(cosine, place / (levels - 1.0)) * (size - 1.0) + 0.5) / size).rg;

  vec3 f0 = mix(vec3(dielectric), a, rm.g);
  float grazing = dielectric == 0.0 ? rm.g : 1.0;  // no highlight, none at grazing angles
  vec3 radiance = a * (1.0 - rm.g) * lit(normal, levels) / PI + (f0 * ab.x + grazing * ab.y) * mirrored;
  radiance = clamp(radiance, 0.0, 1.0);
  vec3 low = 12.92 * radiance, high = 1.055 * pow(radiance, vec3(1.0 / 2.4)) - 0.055;
  shown = vec4(mix(high, low, vec3(lessThan(radiance, vec3(0.0031308)))), 1.0);
}`;

function compiled(kind, text) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw gl.getShaderInfoLog(shader);
  return shader;
}

const program = gl.createProgram();
gl.attachShader(program, compiled(gl.VERTEX_SHADER, VERTEX));
gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, FRAGMENT));
gl.linkProgram(program);
gl.useProgram(program);
const uniform = (name) => gl.getUniformLocation(program, name);

function attribute(name, values, width, kind) {
  const place = gl.getAttribLocation(program, name);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, width, kind, true, 0, 0);
}
attribute("position", as(Uint16Array, data.mesh.position), 3, gl.UNSIGNED_SHORT);
attribute("normal", as(Int8Array, data.mesh.normal), 3, gl.BYTE);
attribute("uv", as(Uint16Array, data.mesh.uv), 2, gl.UNSIGNED_SHORT);
const triangles = as(Uint32Array, data.mesh.triangle);
gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
gl.uniform3fv(uniform("low"), data.mesh.low);
gl.uniform3fv(uniform("size"), data.mesh.size);

function texture(target, wrap, filter) {
  const made = gl.createTexture();
  gl.bindTexture(target, made);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, wrap);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  return made;
}

function lightTexture(text) {
  const made = texture(gl.TEXTURE_2D_ARRAY, gl.REPEAT, gl.LINEAR);
  const sides = [2 * data.rows, data.rows, data.levels + 1];
  gl.texImage3D(
    gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, ...sides, 0, gl.RGBA, gl.HALF_FLOAT, as(Uint16Array, text));
  return made;
}

async function mapTexture(address, format) {
  const image = new Image();
  image.src = address;
  await image.decode();
  const made = texture(gl.TEXTURE_2D, gl.CLAMP_TO_EDGE, gl.LINEAR_MIPMAP_LINEAR);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, gl.RGBA, gl.UNSIGNED_BYTE, image);
  gl.generateMipmap(gl.TEXTURE_2D);
  return made;
}

gl.activeTexture(gl.TEXTURE3);
texture(gl.TEXTURE_2D, gl.CLAMP_TO_EDGE, gl.LINEAR);
const albedo = as(Uint16Array, data.albedo);
gl.texImage2D(
  gl.TEXTURE_2D, 0, gl.RG16F, data.cosines, data.levels, 0, gl.RG, gl.HALF_FLOAT, albedo);
gl.activeTexture(gl.TEXTURE0);
const other = lightTexture(data.other);
["color", "gloss", "light", "albedo"].forEach((name, k) => gl.uniform1i(uniform(name), k));
for (const name of ["smoothest", "roughest", "levels"]) gl.uniform1f(uniform(name), data[name]);

// the camera on a sphere about the object: angles in radians, distance in its radii
const middle = data.mesh.low.map((x, k) => x + data.mesh.size[k] / 2);
const radius = Math.hypot(...data.mesh.size) / 2;
const [x, y, z] = data.toward;
const view = {
  azimuth: Math.atan2(x, z), height: Math.atan2(y, Math.hypot(x, z)), away: 2.3, turned: 0,
  chosen: 0, own: true,
};
const FIELD = (45 * Math.PI) / 180;
const made = [];  // textures of every explanation, once it was chosen

const minus = (a, b) => a.map((v, k) => v - b[k]);
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a.reduce((sum, v, k) => sum + v * b[k], 0);
const unit = (a) => a.map((v) => v / Math.hypot(...a));

function camera(eye, aspect) {  // column by column
  const back = unit(minus(eye, middle));
  const right = unit(cross([0, 1, 0], back));
  const up = cross(back, right);
  const near = radius * 0.05, far = radius * 20, f = 1 / Math.tan(FIELD / 2);
  const rows = [
    [...right, -dot(right, eye)].map((v) => (v * f) / aspect),
    [...up, -dot(up, eye)].map((v) => v * f),
    [...back, -dot(back, eye)].map(
      (v, k) => (v * (far + near)) / (near - far) + (k === 3 ? (2 * far * near) / (near - far) : 0)),
    [...back, -dot(back, eye)].map((v) => -v),
  ];
  return [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
}

async function chosen(k) {
  const from = data.shown[k];
  made[k] = made[k] || {
    color: await mapTexture(from.color, gl.SRGB8_ALPHA8),
    gloss: await mapTexture(from.gloss, gl.RGBA8),
    light: lightTexture(from.light),
  };
  return made[k];
}

async function draw() {
  const own = await chosen(view.chosen);
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  const flat = Math.cos(view.height) * view.away * radius;
  const eye = [
    middle[0] + flat * Math.sin(view.azimuth),
    middle[1] + view.away * radius * Math.sin(view.height),
    middle[2] + flat * Math.cos(view.azimuth),
  ];
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  [own.color, own.gloss].forEach((map, k) => {
    gl.activeTexture(gl.TEXTURE0 + k);
    gl.bindTexture(gl.TEXTURE_2D, map);
  });
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, view.own ? own.light : other);
  gl.uniformMatrix4fv(uniform("camera"), false, camera(eye, canvas.width / canvas.height));
  gl.uniform3fv(uniform("eye"), eye);
  gl.uniform1f(uniform("turned"), view.turned);
  gl.uniform1f(uniform("dielectric"), data.shown[view.chosen].head_on);
  gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
}

let asked = false;
function show(change) {
  Object.assign(view, change);
  view.height = Math.min(Math.max(view.height, -1.5), 1.5);
  view.away = Math.min(Math.max(view.away, 1.2), 12);
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}

canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
canvas.addEventListener("pointermove", (e) => {
  if (!e.buttons) return;
  const by = 4 / canvas.clientHeight;
  show({ azimuth: view.azimuth - by * e.movementX, height: view.height + by * e.movementY });
});
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  show({ away: view.away * Math.exp(0.001 * e.deltaY) });
}, { passive: false });
const KEYS = {
  ArrowLeft: () => ({ azimuth: view.azimuth - 0.1 }), ArrowRight: () => ({ azimuth: view.azimuth + 0.1 }),
  ArrowUp: () => ({ height: view.height + 0.1 }), ArrowDown: () => ({ height: view.height - 0.1 }),
  "+": () => ({ away: view.away / 1.1 }), "-": () => ({ away: view.away * 1.1 }),
};
canvas.addEventListener("keydown", (e) => {
  if (!KEYS[e.key]) return;
  e.preventDefault();
  show(KEYS[e.key]());
});
for (const input of document.querySelectorAll("#viewer-box input")) {
  input.addEventListener("input", () => {
    if (input.name === "shown") show({ chosen: Number(input.value) });
    if (input.name === "light") show({ own: input.value === "own" });
    if (input.name === "turn") show({ turned: (Number(input.value) * Math.PI) / 180 });
  });
}
new ResizeObserver(() => show({})).observe(canvas);
})();
