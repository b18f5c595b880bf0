// One shape in one canvas: camera, colours, markers, and the vertex under the pointer.

const FIELD_OF_VIEW = 28;
const LINEAR = Float32Array.from({ length: 256 }, (_, level) => {
  const value = level / 255;
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
});
const MARK_COLOURS = { pinned: 0xd4145a, hovered: 0x111111 };
// Squares of a checkerboard that lies in the coordinates "laid", their edges one pixel soft. Where a torn map squeezes
// many squares into a pixel, they fade to their mean.
const CHECKER_FRAGMENT = `#include <color_fragment>
  vec2 square = 2.0 * abs(fract(laid / 2.0) - 0.5) - 0.5;
  vec2 width = max(fwidth(laid), vec2(1e-5));
  vec2 way = clamp(square / width, -0.5, 0.5) * clamp(1.5 - width.x - width.y, 0.0, 1.0);
  diffuseColor.rgb *= mix(1.0, 0.67 + 1.32 * way.x * way.y, checkered);`;

class ShapeView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {string} side "source" or "target"
   * @param {number[]} frame half the width, height and depth that must fit into the view, the same for both shapes
   */
  constructor(canvas, side, frame) {
    this.canvas = canvas;
    this.side = side;
    this.frame = frame;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.01, 100);
    this.scene.add(this.camera);
    this.addLights();
    this.addSurface();
    this.marks = { hovered: this.makeMark(MARK_COLOURS.hovered), pinned: this.makeMark(MARK_COLOURS.pinned) };
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => { this.turned?.(); this.requestDraw(); });
    this.raycaster = new THREE.Raycaster();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
    this.frontView();
  }

  addLights() {
    // Lights hang on the camera, so that what is looked at is lit.
    const key = new THREE.DirectionalLight(0xffffff, 2.1);
    key.position.set(-0.5, 0.7, 1);
    const fill = new THREE.DirectionalLight(0xffffff, 0.5);
    fill.position.set(1, 0.1, 0.5);
    this.camera.add(key, fill);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xb8c0c8, 1.0));
  }

  addSurface() {
    const { low, span } = facts[this.side];
    const stored = arrayValues(`${this.side}-positions`);
    const positions = new Float32Array(stored.length);
    for (let i = 0; i < stored.length; i += 1) positions[i] = low[i % 3] + (stored[i] / 65535) * span;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(stored.length).fill(0.6), 3));
    geometry.setAttribute("place", new THREE.BufferAttribute(new Float32Array((2 * stored.length) / 3), 2));
    geometry.setIndex(new THREE.BufferAttribute(arrayValues(`${this.side}-faces`), 1));
    geometry.computeVertexNormals();
    geometry.computeBoundingBox();
    geometry.computeBoundingSphere();
    const material = new THREE.MeshStandardMaterial({
      vertexColors: true, roughness: 0.75, metalness: 0, side: THREE.DoubleSide,
    });
    this.checkered = { value: 0 };
    material.onBeforeCompile = (shader) => {
      shader.uniforms.checkered = this.checkered;
      shader.vertexShader = `attribute vec2 place;\nvarying vec2 laid;\n${shader.vertexShader}`
        .replace("#include <begin_vertex>", "#include <begin_vertex>\n  laid = place;");
      shader.fragmentShader = `uniform float checkered;\nvarying vec2 laid;\n${shader.fragmentShader}`
        .replace("#include <color_fragment>", CHECKER_FRAGMENT);
    };
    this.positions = positions;
    this.surface = new THREE.Mesh(geometry, material);
    this.centre = geometry.boundingBox.getCenter(new THREE.Vector3());
    this.scene.add(this.surface);
  }

  makeMark(colour) {
    const ball = new THREE.SphereGeometry(0.011, 20, 14);
    const solid = new THREE.Mesh(ball, new THREE.MeshBasicMaterial({ color: colour }));
    // A faint second ball is drawn over everything, so that a match on the far side is not lost.
    const through = new THREE.Mesh(ball, new THREE.MeshBasicMaterial({
      color: colour, transparent: true, opacity: 0.4, depthTest: false,
    }));
    through.renderOrder = 1;
    const mark = new THREE.Group().add(solid, through);
    mark.visible = false;
    this.scene.add(mark);
    return mark;
  }

  /** Show a mark ("hovered" or "pinned") at a vertex, or hide it (vertex < 0). */
  setMark(kind, vertex) {
    const mark = this.marks[kind];
    mark.visible = vertex >= 0;
    if (mark.visible) mark.position.fromArray(this.positions, 3 * vertex);
    this.requestDraw();
  }

  /** Show balls at landmarks, a list of { vertex, colour }, in place of those before. */
  setLandmarks(points) {
    this.landmarks?.forEach((mark) => this.scene.remove(mark));
    this.landmarks = points.map(({ vertex, colour }) => {
      const mark = this.makeMark(colour);
      mark.visible = true;
      mark.scale.setScalar(1.3);
      mark.position.fromArray(this.positions, 3 * vertex);
      return mark;
    });
    this.requestDraw();
  }

  /** Paint every vertex; `rgb` holds 0 to 255 for each channel of each vertex. */
  paint(rgb) {
    const colour = this.surface.geometry.getAttribute("color");
    for (let i = 0; i < rgb.length; i += 1) colour.array[i] = LINEAR[rgb[i]];
    colour.needsUpdate = true;
    this.requestDraw();
  }

  /** Darken every other square of a board; `places` holds two coordinates a vertex, one square being one unit. */
  check(places) {
    this.checkered.value = places ? 1 : 0;
    if (places) {
      const stored = this.surface.geometry.getAttribute("place");
      stored.array.set(places);
      stored.needsUpdate = true;
    }
    this.requestDraw();
  }

  listen() {
    let pressed = null;
    let pending = null;
    this.canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
    this.canvas.addEventListener("pointerup", (event) => {
      const still = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4;
      pressed = null;
      if (still && event.button === 0) this.clicked?.(this.pick(event));
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) return;
      if (pending === null) {
        requestAnimationFrame(() => { const latest = pending; pending = null; if (latest) this.hovered?.(this.pick(latest)); });
      }
      pending = event;
    });
    this.canvas.addEventListener("pointerleave", () => { pending = null; this.hovered?.(-1); });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key in turns) this.turn(...turns[event.key].map((steps) => steps * 0.15), 1);
    else if (event.key === "+" || event.key === "=") this.turn(0, 0, 1 / 1.15);
    else if (event.key === "-") this.turn(0, 0, 1.15);
    else if (event.key === "0") this.frontView();
    else if (event.key === "Escape") this.cleared?.();
    else return;
    event.preventDefault();
  }

  /** Move the camera around the shape by angles (radians) and scale its distance. */
  turn(around, over, nearer) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const place = new THREE.Spherical().setFromVector3(offset);
    place.theta += around;
    place.phi += over;
    place.radius *= nearer;
    this.camera.position.copy(this.controls.target).add(offset.setFromSpherical(place.makeSafe()));
    this.controls.update();
  }

  /** Nearest vertex of the surface point under the pointer, or -1. */
  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    const place = new THREE.Vector2(
      (2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height,
    );
    this.raycaster.setFromCamera(place, this.camera);
    const [hit] = this.raycaster.intersectObject(this.surface);
    if (!hit) return -1;
    const distance = (vertex) => hit.point.distanceTo(new THREE.Vector3().fromArray(this.positions, 3 * vertex));
    return [hit.face.a, hit.face.b, hit.face.c].reduce((best, vertex) => (distance(vertex) < distance(best) ? vertex : best));
  }

  frontView() {
    const slope = Math.tan((FIELD_OF_VIEW / 2) * (Math.PI / 180));
    const [halfWidth, halfHeight, halfDepth] = this.frame;
    const distance = 1.08 * Math.max(halfHeight / slope, halfWidth / (slope * this.camera.aspect)) + halfDepth;
    this.controls.target.copy(this.centre);
    this.camera.position.copy(this.centre).add(new THREE.Vector3(0, 0, distance));
    this.controls.update();
    this.requestDraw();
  }

  /** Where this view looks from, relative to its shape. */
  get pose() {
    return {
      offset: this.camera.position.clone().sub(this.controls.target),
      shift: this.controls.target.clone().sub(this.centre),
    };
  }

  /** Look as another view does, without telling it back. */
  follow(pose) {
    const turned = this.turned;
    this.turned = null;
    this.controls.target.copy(this.centre).add(pose.shift);
    this.camera.position.copy(this.controls.target).add(pose.offset);
    this.controls.update();
    this.turned = turned;
    this.requestDraw();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    if (!clientWidth || !clientHeight) return;
    const before = this.camera.aspect;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    // A view that became narrower steps back by as much as the shape's width asks for.
    if (this.controls && this.camera.aspect !== before) this.refit(before);
    this.draw();
  }

  refit(before) {
    const [halfWidth, halfHeight] = this.frame;
    const needed = (aspect) => Math.max(halfHeight, halfWidth / aspect);
    const offset = this.camera.position.clone().sub(this.controls.target);
    this.camera.position.copy(this.controls.target).add(offset.multiplyScalar(needed(this.camera.aspect) / needed(before)));
    this.controls.update();
  }

  requestDraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
  }
}
