// The robot in three dimensions.

import {
  AmbientLight,
  ArrowHelper,
  AxesHelper,
  Box3,
  BoxGeometry,
  BufferGeometry,
  CapsuleGeometry,
  Color,
  ConeGeometry,
  CylinderGeometry,
  DirectionalLight,
  EdgesGeometry,
  ExtrudeGeometry,
  GridHelper,
  Group,
  Line,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  Object3D,
  PerspectiveCamera,
  Quaternion,
  Scene as Graph,
  Shape,
  SphereGeometry,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Contact, ObjectShape, Pose, Replay, Scene, SolidShape, Vec } from "./data";
import { light, onThemeChange, theme, type Theme } from "./theme";

/** Shared materials: a change of theme only changes their colours. */
interface Paints {
  link: MeshStandardMaterial;
  base: MeshStandardMaterial;
  tip: MeshStandardMaterial;
  object: MeshStandardMaterial;
  fixture: MeshStandardMaterial;
  ghost: MeshStandardMaterial;
  goal: MeshBasicMaterial;
  cone: MeshBasicMaterial;
  edge: LineBasicMaterial;
  line: LineBasicMaterial;
}

/** A robot whose joints can be set. */
class Figure {
  readonly root = new Group();
  /** Frames moved by the joints. */
  readonly frames: Group[] = [];
  readonly tips: Object3D[] = [];
  private readonly axes: Vector3[] = [];

  constructor(private readonly scene: Scene, paint: (base: boolean) => MeshStandardMaterial, tip: MeshStandardMaterial | MeshBasicMaterial) {
    for (const joint of scene.joints) {
      this.frames.push(new Group());
      this.axes.push(new Vector3(...joint.axis).normalize());
    }
    scene.joints.forEach((joint, index) => {
      const origin = placed(new Group(), joint.origin);
      origin.add(this.frames[index]);
      this.frame(joint.parent).add(origin);
    });
    if (scene.solids.length > 0) {
      for (const { joint, pose, shape } of scene.solids) {
        this.frame(joint).add(placed(new Mesh(solid(shape), paint(joint === null)), pose));
      }
    } else {
      this.addRods(paint);
    }
    const size = extent(scene);
    for (const { joint, pose, radius } of scene.tips) {
      const ball = new Mesh(new SphereGeometry(radius > 0 ? 1.02 * radius : 0.01 * size, 24, 16), tip);
      this.frame(joint).add(placed(ball, pose));
      this.tips.push(ball);
    }
  }

  private frame(joint: number | null): Object3D {
    return joint === null ? this.root : (this.frames[joint] ?? this.root);
  }

  /** Draws a robot without geometry: a hub along each axis, and a rod from each joint to what it carries. */
  private addRods(paint: (base: boolean) => MeshStandardMaterial): void {
    const thickness = 0.022 * extent(this.scene);
    const rod = (joint: number | null, pose: Pose) => {
      const end = new Vector3(pose[0], pose[1], pose[2]);
      if (end.length() < thickness) return;
      const mesh = new Mesh(new CapsuleGeometry(thickness * 0.7, end.length(), 6, 16), paint(joint === null));
      mesh.position.copy(end).multiplyScalar(0.5);
      mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), end.clone().normalize());
      this.frame(joint).add(mesh);
    };
    this.scene.joints.forEach((joint, index) => {
      rod(joint.parent, joint.origin);
      const hub = new Mesh(new CylinderGeometry(thickness, thickness, 2.6 * thickness, 24), paint(true));
      hub.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), this.axes[index]);
      this.frames[index].add(hub);
    });
    for (const tip of this.scene.tips) rod(tip.joint, tip.pose);
  }

  /** Sets the joints that have values; the others follow. */
  set(values: number[]): void {
    this.scene.joints.forEach((joint, index) => {
      const { follows } = joint;
      const value = follows ? (values[follows[0]] ?? 0) * follows[1] + follows[2] : (values[index] ?? 0);
      this.frames[index].quaternion.setFromAxisAngle(this.axes[index], Number.isFinite(value) ? value : 0);
    });
  }
}

function placed<T extends Object3D>(object: T, pose: Pose): T {
  object.position.set(pose[0], pose[1], pose[2]);
  object.quaternion.set(pose[3], pose[4], pose[5], pose[6]);
  return object;
}

/** Returns about how far the robot reaches [m]: the length of its longest chain. */
function extent(scene: Scene): number {
  const reach = scene.joints.map(() => 0);
  const length = (pose: Pose) => Math.hypot(pose[0], pose[1], pose[2]);
  const to = (joint: number | null): number => {
    if (joint === null) return 0;
    reach[joint] ||= length(scene.joints[joint].origin) + to(scene.joints[joint].parent);
    return reach[joint];
  };
  return Math.max(0.05, ...scene.tips.map((tip) => to(tip.joint) + length(tip.pose)));
}

function solid(shape: SolidShape | ObjectShape): BufferGeometry {
  if ("box" in shape) return new BoxGeometry(...shape.box);
  if ("sphere" in shape) return new SphereGeometry(shape.sphere, 32, 20);
  if ("cylinder" in shape) {
    // The cylinder of three.js is along y.
    return new CylinderGeometry(shape.cylinder[0], shape.cylinder[0], shape.cylinder[1], 40).rotateX(Math.PI / 2);
  }
  const [x, y, z, top] = shape.wedge;
  const outline = new Shape();
  outline.moveTo(-x / 2, -z / 2).lineTo(x / 2, -z / 2).lineTo((top * x) / 2, z / 2).lineTo((-top * x) / 2, z / 2);
  // Rotated into the plane of x and z, so that it extends along −y.
  return new ExtrudeGeometry(outline, { depth: y, bevelEnabled: false }).rotateX(Math.PI / 2).translate(0, y / 2, 0);
}

/** Whether rendering is done in software, without a graphics card. */
function isSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

/** Thrown where there is no WebGL. */
export class NoWebGL extends Error {}

export class Stage {
  private readonly renderer: WebGLRenderer;
  private readonly graph = new Graph();
  private readonly camera = new PerspectiveCamera(32, 1, 0.001, 100);
  private controls: OrbitControls | null = null;
  private readonly paints: Paints;
  private readonly up = new Vector3(0, 0, 1);
  private readonly overlay = new Group();
  private objects: { since: number; frame: string | null; group: Group }[] = [];
  private grid: GridHelper | null = null;
  private figure: Figure | null = null;
  private ghost: Figure | null = null;
  private scene: Scene | null = null;
  private size = 0.3;
  private dirty = true;
  private fitted = false;
  private frames: { measured: AxesHelper; target: AxesHelper; line: Line } | null = null;

  /** With `isLive`, timely pictures matter more than smooth edges. */
  constructor(private readonly container: HTMLElement, isLive = false) {
    const isSlow = isLive && isSoftware();
    try {
      this.renderer = new WebGLRenderer({ antialias: !isSlow });
    } catch (error) {
      throw new NoWebGL(String(error instanceof Error ? error.message : error));
    }
    this.renderer.setPixelRatio(isSlow ? 1 : Math.min(devicePixelRatio, 2));
    container.append(this.renderer.domElement);
    this.renderer.domElement.setAttribute("role", "img");
    this.renderer.domElement.setAttribute("aria-label", "The robot in three dimensions. Drag to turn it, scroll to zoom.");
    const plain = (extra: object) => new MeshStandardMaterial({ roughness: 0.62, metalness: 0.05, ...extra });
    this.paints = {
      link: plain({}),
      base: plain({}),
      tip: plain({}),
      object: plain({ transparent: true, opacity: 0.5, depthWrite: false }),
      // A door must not hide the hand behind it.
      fixture: plain({ transparent: true, opacity: 0.35, depthWrite: false }),
      ghost: plain({ transparent: true, opacity: 0.26, depthWrite: false }),
      goal: new MeshBasicMaterial({ transparent: true, opacity: 0.6, depthWrite: false }),
      cone: new MeshBasicMaterial({ transparent: true, opacity: 0.22, depthWrite: false, depthTest: false }),
      edge: new LineBasicMaterial({ transparent: true, opacity: 0.5 }),
      line: new LineBasicMaterial({}),
    };
    const key = new DirectionalLight("#ffffff", 2.2);
    const fill = new DirectionalLight("#ffffff", 0.7);
    // The lights move with the camera, so that no side is ever dark.
    key.position.set(-1, 2, 2);
    fill.position.set(2, -0.5, 1);
    this.camera.add(key, fill);
    this.graph.add(this.camera, new AmbientLight("#ffffff", 1.1), this.overlay);
    new ResizeObserver(() => this.resize()).observe(container);
    onThemeChange(() => this.dress(theme()));
    this.dress(theme());
    const loop = () => {
      requestAnimationFrame(loop);
      if (this.dirty) this.draw();
    };
    requestAnimationFrame(loop);
  }

  /** Called when the WebGL context is lost, for example by a driver reset. */
  onLost(action: () => void): void {
    this.renderer.domElement.addEventListener("webglcontextlost", action);
  }

  private dress(colours: Theme): void {
    const { paints } = this;
    this.graph.background = new Color(colours.ground);
    paints.link.color.set(colours.link);
    paints.base.color.set(colours.base);
    paints.tip.color.set(colours.tip);
    paints.object.color.set(colours.object);
    paints.fixture.color.set(colours.base);
    paints.ghost.color.set(colours.accent);
    paints.goal.color.set(colours.accent);
    paints.cone.color.set(colours.force);
    paints.edge.color.set(colours.muted);
    paints.line.color.set(colours.accent);
    this.layGrid(colours);
    this.dirty = true;
  }

  private layGrid(colours: Theme): void {
    if (this.grid) {
      this.graph.remove(this.grid);
      this.grid.dispose();
    }
    if (!this.figure) return;
    // A grid of 5 cm or 20 cm cells, below everything.
    const cell = this.size > 0.6 ? 0.2 : 0.05;
    const count = 2 * Math.ceil((1.3 * this.size) / cell);
    const colour = new Color(colours.grid);
    this.grid = new GridHelper(count * cell, count, colour, colour);
    this.grid.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), this.up);
    this.grid.position.copy(this.up).multiplyScalar(this.floor());
    this.graph.add(this.grid);
  }

  /** Height of the lowest solid. */
  private floor(): number {
    const box = new Box3().setFromObject(this.figure!.root);
    for (const { group, frame } of this.objects) if (group.visible && frame !== null) box.expandByObject(group);
    const corner = (high: boolean) => (high ? box.max : box.min);
    const lowest = new Vector3(
      corner(this.up.x < 0).x,
      corner(this.up.y < 0).y,
      corner(this.up.z < 0).z,
    );
    return lowest.dot(this.up) - 0.001;
  }

  /** Shows a robot. */
  load(scene: Scene): void {
    for (const root of [this.figure?.root, this.ghost?.root, ...this.objects.map(({ group }) => group)]) {
      if (!root) continue;
      this.graph.remove(root);
      root.traverse((part) => part instanceof Mesh && part.geometry.dispose());
    }
    this.objects = [];
    this.scene = scene;
    const gravity = new Vector3(...scene.gravity);
    if (gravity.length() > 1) this.up.copy(gravity).multiplyScalar(-1).normalize();
    this.camera.up.copy(this.up);
    // The controls read `up` only when they are created.
    this.controls?.dispose();
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => (this.dirty = true));
    const { paints } = this;
    this.figure = new Figure(scene, (base) => (base ? paints.base : paints.link), paints.tip);
    this.ghost = new Figure(scene, () => paints.ghost, paints.goal);
    this.ghost.root.visible = false;
    this.graph.add(this.figure.root, this.ghost.root);
    this.size = extent(scene);
    this.fitted = false;
    this.dirty = true;
  }

  /** Adds bodies that are not links; each is shown at its time. */
  addObjects(objects: Replay["objects"]): void {
    for (const { since, frame, shape, pose } of objects) {
      const geometry = solid(shape);
      const mesh = placed(new Mesh(geometry, frame === null ? this.paints.fixture : this.paints.object), pose);
      mesh.add(new LineSegments(new EdgesGeometry(geometry, 30), this.paints.edge));
      const group = new Group().add(mesh);
      group.visible = false;
      this.objects.push({ since, frame, group });
      this.graph.add(group);
    }
  }

  setJoints(measured: number[], reference: number[] | null): void {
    this.figure?.set(measured);
    if (this.ghost) {
      const away = reference?.some((value, index) => Math.abs(value - (measured[index] ?? 0)) > 0.004) ?? false;
      this.ghost.root.visible = away;
      if (reference) this.ghost.set(reference);
    }
    if (!this.fitted) this.fit();
    this.dirty = true;
  }

  /** Shows the bodies of a time, the moving ones at their frames. */
  setFrames(time: number, frames: [string, Pose][]): void {
    const since = Math.max(...this.objects.map((object) => object.since).filter((other) => other <= time + 1e-9));
    for (const object of this.objects) {
      const frame = frames.find(([name]) => name === object.frame);
      if (frame) placed(object.group, frame[1]);
      object.group.visible = object.since === since && (object.frame === null || frame !== undefined);
    }
    this.dirty = true;
  }

  /** Shows forces as arrows, each with its friction cone if known. */
  setContacts(contacts: Contact[], aims: { point: Vec; force: Vec }[] = []): void {
    for (const old of this.overlay.children.filter((child) => child.userData.contact)) {
      this.overlay.remove(old);
      old.traverse((part) => (part as Mesh).geometry?.dispose?.());
    }
    const colours = theme();
    // Sensor noise must not give a long arrow; sensors of arms measure larger forces than those of fingers.
    const floor = this.size > 0.5 ? 10 : 0.6;
    const largest = Math.max(floor, ...contacts.map((contact) => Math.hypot(...contact.force)));
    const scale = (0.3 * this.size) / largest;
    for (const { point, force, normal, friction } of contacts) {
      this.arrow(point, force, scale, colours.force);
      const axis = new Vector3(...normal);
      if (axis.length() > 0.5 && friction > 0) {
        const height = 0.2 * this.size;
        const cone = new Mesh(new ConeGeometry(height * friction, height, 40, 1, true), this.paints.cone);
        // Its apex is at the contact, and it opens into the object.
        cone.geometry.translate(0, -height / 2, 0);
        cone.quaternion.setFromUnitVectors(new Vector3(0, -1, 0), axis.normalize());
        cone.position.set(...point);
        cone.renderOrder = 1;
        cone.userData.contact = true;
        this.overlay.add(cone);
      }
    }
    for (const { point, force } of aims) this.arrow(point, force, scale, colours.accent);
    this.dirty = true;
  }

  private arrow(point: Vec, force: Vec, scale: number, colour: string): void {
    const vector = new Vector3(...force);
    const length = vector.length() * scale;
    if (!(length > 0.012 * this.size)) return;
    const head = Math.min(0.4 * length, 0.05 * this.size);
    const arrow = new ArrowHelper(vector.normalize(), new Vector3(...point), length, colour, head, 0.6 * head);
    // Visible even inside an object.
    for (const part of [arrow.line, arrow.cone]) {
      Object.assign(part.material as MeshBasicMaterial, { depthTest: false, transparent: true });
      part.renderOrder = 2;
    }
    arrow.userData.contact = true;
    this.overlay.add(arrow);
  }

  /** Shows a frame that a task controls, and its set-point. */
  setTaskFrame(frame: Pose | undefined, target: Pose | undefined): void {
    if (!this.frames) {
      const length = 0.18 * this.size;
      const measured = new AxesHelper(length);
      const aim = new AxesHelper(0.7 * length);
      const line = new Line(new BufferGeometry(), this.paints.line);
      (measured.material as LineBasicMaterial).depthTest = false;
      (aim.material as LineBasicMaterial).opacity = 0.5;
      (aim.material as LineBasicMaterial).transparent = true;
      this.frames = { measured, target: aim, line };
      this.overlay.add(measured, aim, line);
    }
    const { measured, target: aim, line } = this.frames;
    measured.visible = frame !== undefined;
    aim.visible = target !== undefined;
    line.visible = frame !== undefined && target !== undefined;
    if (frame) placed(measured, frame);
    if (target) placed(aim, target);
    if (frame && target) {
      line.geometry.setFromPoints([measured.position, aim.position]);
    }
    this.dirty = true;
  }

  /** Where the tips are [m], as drawn. */
  tipPositions(): Vec[] {
    this.figure?.root.updateWorldMatrix(true, true);
    return (this.figure?.tips ?? []).map((tip) => tip.getWorldPosition(new Vector3()).toArray() as Vec);
  }

  /** Places the camera so that everything is in view. */
  fit(): void {
    if (!this.figure || !this.scene || !this.controls) return;
    const box = new Box3().setFromObject(this.figure.root);
    // Fixed bodies, such as a door, may be much larger than the robot.
    for (const { group, frame } of this.objects) if (group.visible && frame !== null) box.expandByObject(group);
    const center = box.getCenter(new Vector3());
    const radius = 0.5 * box.getSize(new Vector3()).length();
    const { clientWidth: width, clientHeight: height } = this.container;
    const narrow = Math.min(1, width / Math.max(1, height));
    const distance = (1.02 * radius) / Math.sin((this.camera.fov * Math.PI) / 360) / Math.max(0.4, narrow);
    const side = new Vector3(1, -1.25, 0.62).applyQuaternion(new Quaternion().setFromUnitVectors(new Vector3(0, 0, 1), this.up));
    this.camera.position.copy(center).addScaledVector(side.normalize(), distance);
    this.camera.near = distance / 100;
    this.camera.far = distance * 20;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(center);
    this.controls.update();
    this.size = Math.max(extent(this.scene) * 0.9, 0.05);
    this.layGrid(theme());
    this.fitted = width > 0;
    this.dirty = true;
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.fitted) this.fit();
    this.draw();
  }

  /** Draws at once; otherwise the next frame is drawn if something has changed. */
  draw(): void {
    this.dirty = false;
    this.renderer.render(this.graph, this.camera);
  }

  /** Returns a picture of what is shown now, on white. */
  picture(width: number, height: number, background = "#ffffff"): string {
    const { clientWidth, clientHeight } = this.container;
    const aspect = this.camera.aspect;
    const ratio = this.renderer.getPixelRatio();
    this.dress(light);
    this.graph.background = new Color(background);
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
    const url = this.renderer.domElement.toDataURL("image/png");
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(clientWidth || width, clientHeight || height);
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
    this.dress(theme());
    return url;
  }
}
