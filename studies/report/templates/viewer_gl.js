// Drawing with WebGL 2. All that the graphics card holds is made here, and made again after its context was lost.

const VERTEX = `
  in vec3 position; in float value;
  uniform mat3 turn; uniform vec3 centre, size; uniform vec3 shift; uniform float point;
  out vec3 eye; out float shade;
  void main() {
    eye = turn * (position - centre); shade = value;
    gl_Position = vec4(eye * size + shift, 1.0); gl_PointSize = point;
  }`;
const SURFACE = `
  in vec3 eye; in float shade;
  uniform sampler2D ramp;
  out vec4 colour;
  void main() {
    vec3 normal = normalize(cross(dFdx(eye), dFdy(eye)));
    float above = max(dot(normal, normalize(vec3(-0.4, 0.7, 0.6))), 0.0);
    float light = 0.62 + 0.30 * max(normal.z, 0.0) + 0.16 * above;
    colour = vec4(texture(ramp, vec2(clamp(shade, 0.0, 1.0) * 0.996 + 0.002, 0.5)).rgb * light, 1.0);
  }`;
const FLAT = `
  in vec3 eye; in float shade;
  uniform vec4 ink; uniform bool dot_;
  out vec4 colour;
  void main() {
    if (dot_ && distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;
    colour = vec4(ink.rgb * ink.a, ink.a);
  }`;
const AROUND = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]]; // of a thick line
const NEARER = 0.004; // of a thick line, so that the facets beside it do not cut it

function makeGpu(gl, ramps) {
  const program = (fragment) => {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.bindAttribLocation(made, 0, "position");
    gl.bindAttribLocation(made, 1, "value");
    gl.linkProgram(made);
    return { made, at: (name) => gl.getUniformLocation(made, name) };
  };
  const surface = program(SURFACE), flat = program(FLAT);

  const textures = Object.fromEntries(Object.entries(ramps).map(([name, colours]) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    return [name, texture];
  }));

  const buffers = {};
  const upload = (name, array) => {
    const target = array instanceof Uint32Array ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
    buffers[name] ??= { made: gl.createBuffer(), size: 0 };
    buffers[name].size = array.length;
    gl.bindBuffer(target, buffers[name].made);
    gl.bufferData(target, array, gl.DYNAMIC_DRAW);
  };
  const attribute = (index, name, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name].made);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, gl.FLOAT, false, 0, 0);
  };
  const elements = (mode, name) => {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[name].made);
    gl.drawElements(mode, buffers[name].size, gl.UNSIGNED_INT, 0);
  };

  function clear() {
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // one view: {name, ramp, x, y, width, height in pixels from below}; camera: {axes, centre, sizes}
  function draw(view, camera, look) {
    gl.viewport(view.x, view.y, view.width, view.height);
    const use = (p, point = 1) => {
      gl.useProgram(p.made);
      const [right, up, towards] = camera.axes;
      gl.uniformMatrix3fv(p.at("turn"), false, [0, 1, 2].flatMap((k) => [right[k], up[k], towards[k]]));
      gl.uniform3fv(p.at("centre"), camera.centre);
      gl.uniform3fv(p.at("size"), camera.sizes);
      gl.uniform3f(p.at("shift"), 0, 0, 0);
      gl.uniform1f(p.at("point"), point);
    };
    const lines = (positions, edges, colour, thickness = 0) => {
      use(flat);
      gl.uniform4fv(flat.at("ink"), colour);
      gl.uniform1i(flat.at("dot_"), 0);
      attribute(0, positions, 3);
      gl.disableVertexAttribArray(1);
      for (const [x, y] of thickness ? AROUND : [[0, 0]]) {
        const nearer = thickness ? -NEARER : 0;
        gl.uniform3f(flat.at("shift"), (2 * thickness * x) / view.width, (2 * thickness * y) / view.height, nearer);
        elements(gl.LINES, edges);
      }
    };
    const dots = (positions, size, colour) => {
      attribute(0, positions, 3);
      use(flat, size * look.ratio);
      gl.uniform4fv(flat.at("ink"), colour);
      gl.uniform1i(flat.at("dot_"), 1);
      gl.drawArrays(gl.POINTS, 0, 1);
    };
    const deformed = "deformed " + view.name;
    use(surface);
    gl.bindTexture(gl.TEXTURE_2D, textures[view.ramp]);
    attribute(0, deformed, 3);
    attribute(1, "value " + view.name, 1);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    elements(gl.TRIANGLES, "triangles");
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (look.edges) lines(deformed, "edges", look.edges);
    if (look.rest) lines("rest", "edges", look.rest);
    gl.depthMask(false); // a line does not hide the finer one upon it
    for (const { name, colour, halo } of look.rims) {
      lines(deformed, name, halo, 1.8 * look.ratio);
      lines(deformed, name, colour, 0.8 * look.ratio);
    }
    gl.depthMask(true);
    if (!look.node) return;
    gl.disable(gl.DEPTH_TEST);
    for (const [size, colour] of look.node) dots("node " + view.name, size, colour);
    gl.enable(gl.DEPTH_TEST);
  }

  return { upload, clear, draw };
}
