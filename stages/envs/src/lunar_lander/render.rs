//! The rendered image: ground with its pad and flags, the lander on its legs, and what the engines do.

use dril_stage_api::math;

use super::engines::Push;
use super::shape::{HEIGHT, LANDER, LEG, SCALE, WIDTH};
use super::simulation::Simulation;
use super::world::Motion;
use crate::RgbImage;
use crate::drawing::coverage::{AreaCanvas, LINES};
use crate::drawing::surface::Point;
use crate::drawing::surface::Surface;

/// Stars in the sky.
const STARS: u32 = 60;
/// Height of a flag's pole, world units.
const POLE: f64 = 50.0 / SCALE;

/// A colour, as the place where [`COLOURS`] has it. 0 is the sky.
type Ink = u8;
const STAR: Ink = 1;
const GROUND: Ink = 2;
const EDGE: Ink = 3;
const PAD: Ink = 4;
const POLE_INK: Ink = 5;
const FLAG: Ink = 6;
const OUTLINE: Ink = 7;
const HULL: Ink = 8;
const WINDOW: Ink = 9;
const FLAME: Ink = 10;
const GLOW: Ink = 11;
const COLOURS: [[u8; 3]; 12] = [
    [13, 15, 34],
    [150, 156, 184],
    [104, 102, 112],
    [188, 186, 196],
    [240, 214, 96],
    [225, 225, 230],
    [226, 178, 32],
    [70, 60, 132],
    [136, 112, 232],
    [190, 222, 255],
    [255, 132, 28],
    [255, 236, 150],
];

/// Renders a moment.
pub fn draw(simulation: &Simulation, width: usize, height: usize) -> RgbImage {
    let mut painter = Painter::new(width, height);
    painter.stars();
    painter.ground(simulation);
    painter.flames(simulation);
    painter.lander(simulation.motions());
    let mut image = RgbImage::new(width, height);
    painter.canvas.interleave(&mut image.rgb);
    image
}

/// A canvas that shows the whole world, in the middle where the shape differs.
struct Painter {
    canvas: AreaCanvas,
    /// Pixels per world unit.
    zoom: f64,
    /// Where the world's lower left corner is.
    origin: Point,
}

impl Painter {
    fn new(width: usize, height: usize) -> Self {
        let (w, h) = (width as f64, height as f64);
        let zoom = (w / WIDTH).min(h / HEIGHT);
        let origin = [(w - zoom * WIDTH) / 2.0, (h + zoom * HEIGHT) / 2.0];
        let mut canvas = AreaCanvas::new(width, height, 0.0, &COLOURS);
        canvas.clear(0, height * LINES);
        Self { canvas, zoom, origin }
    }

    /// The canvas's point for a point of the world.
    fn dot(&self, [x, y]: [f64; 2]) -> Point {
        [self.origin[0] + self.zoom * x, (self.origin[1] - self.zoom * y) * LINES as f64]
    }

    /// Fills a convex polygon, given in world units.
    fn fill(&mut self, corners: &[[f64; 2]], ink: Ink) {
        let mut dots = [[0.0; 2]; 8];
        for (dot, corner) in dots.iter_mut().zip(corners) {
            *dot = self.dot(*corner);
        }
        let [_, floor] = self.canvas.size();
        self.canvas.fill(&dots[..corners.len()], ink, floor);
    }

    /// The same specks in every image.
    fn stars(&mut self) {
        let [w, h] = self.canvas.size().map(|size| size as f64);
        for i in 0..STARS {
            // Multiples of the golden ratio and of another number badly approximated by fractions are spread evenly.
            let place = [0.618_034, 0.754_878].map(|step| (f64::from(i) * step).fract());
            let [x, y] = [place[0] * w, place[1] * h];
            let side = self.zoom * if i % 5 == 0 { 0.05 } else { 0.03 };
            self.canvas.fill_box([x, y], [x + side, y + side * LINES as f64], STAR);
        }
    }

    fn ground(&mut self, simulation: &Simulation) {
        let terrain = simulation.terrain();
        let flags = terrain.flags();
        self.canvas.begin_mosaic();
        for [[x0, y0], [x1, y1]] in terrain.edges() {
            // To both sides the ground goes on as far as there is an image.
            let left = if x0 <= 0.0 { -WIDTH } else { x0 };
            let right = if x1 >= WIDTH - 1e-9 { 2.0 * WIDTH } else { x1 };
            for [from, to] in [[[left, y0], [x0, y0]], [[x0, y0], [x1, y1]], [[x1, y1], [right, y1]]] {
                let pad = from[0] >= flags[0] - 1e-9 && to[0] <= flags[1] + 1e-9;
                let (ink, thick) = if pad { (PAD, 0.10) } else { (EDGE, 0.05) };
                self.fill(&[from, to, [to[0], to[1] - thick], [from[0], from[1] - thick]], ink);
                self.fill(&[from, to, [to[0], -HEIGHT], [from[0], -HEIGHT]], GROUND);
            }
        }
        let [_, floor] = self.canvas.size();
        self.canvas.end_mosaic(floor);
        for x in flags {
            let foot = terrain.points.iter().find(|point| point[0] >= x - 1e-9).map_or(0.0, |point| point[1]);
            let top = foot + POLE;
            self.fill(&[[x - 0.03, foot], [x + 0.03, foot], [x + 0.03, top], [x - 0.03, top]], POLE_INK);
            self.fill(&[[x + 0.03, top], [x + 0.85, top - 0.17], [x + 0.03, top - 0.34]], FLAG);
        }
    }

    /// A flame away from the lander for every engine that fires.
    fn flames(&mut self, simulation: &Simulation) {
        let lander = &simulation.motions()[0];
        let [main, side] = *simulation.pushes();
        self.flame(lander, main, [0.0, -10.0 / SCALE], 1.3, 0.24);
        let away = if crosswise(lander, side) > 0.0 { -1.0 } else { 1.0 };
        self.flame(lander, side, [away * 16.0 / SCALE, 12.0 / SCALE], 0.75, 0.13);
    }

    /// `nozzle` in the lander's frame; `length` and half the width at full power, world units.
    fn flame(&mut self, lander: &Motion, push: Push, nozzle: [f64; 2], length: f64, half: f64) {
        let [x, y] = push.impulse;
        let strength = math::hypot(x, y);
        if push.power == 0.0 || strength == 0.0 {
            return;
        }
        let from = lander.point(nozzle.map(|v| v as f32)).map(f64::from);
        let along = [-x / strength, -y / strength];
        for (ink, part) in [(FLAME, 1.0), (GLOW, 0.55)] {
            let (far, wide) = (length * push.power * part, half * part);
            let across = [-along[1] * wide, along[0] * wide];
            let at = |share: f64, beside: f64| {
                [0, 1].map(|axis| from[axis] + share * far * along[axis] + beside * across[axis])
            };
            self.fill(&[at(0.0, 0.7), at(0.35, 1.0), at(1.0, 0.0), at(0.35, -1.0), at(0.0, -0.7)], ink);
        }
    }

    fn lander(&mut self, motions: &[Motion; 3]) {
        let [body, legs @ ..] = motions;
        for (leg, side) in legs.iter().zip([1.0, -1.0]) {
            self.strut(body, leg, side);
        }
        for leg in legs {
            self.part(leg, &LEG, 1.0, OUTLINE);
            self.part(leg, &LEG.map(|[x, y]| [x * 0.45, y * 0.88]), 1.0, HULL);
        }
        self.part(body, &LANDER, 1.0, OUTLINE);
        self.part(body, &LANDER.map(|[x, y]| [x, y - 2.0]), 0.88, HULL);
        self.part(body, &[[-5.0, 11.0], [-7.0, 4.0], [7.0, 4.0], [5.0, 11.0]], 1.0, WINDOW);
    }

    /// What holds a leg, on the right (1) or left (-1).
    fn strut(&mut self, body: &Motion, leg: &Motion, side: f32) {
        let pixel = (1.0 / SCALE) as f32;
        let [ax, ay] = body.point([side * 14.0 * pixel, -3.0 * pixel]).map(f64::from);
        let [bx, by] = leg.point([0.0, 5.0 * pixel]).map(f64::from);
        let length = math::hypot(bx - ax, by - ay).max(1e-9);
        let [dx, dy] = [0.03 * (ay - by) / length, 0.03 * (bx - ax) / length];
        self.fill(&[[ax + dx, ay + dy], [bx + dx, by + dy], [bx - dx, by - dy], [ax - dx, ay - dy]], OUTLINE);
    }

    /// A part of a body, given in pixels of the original, shrunk towards the body's origin.
    fn part(&mut self, body: &Motion, outline: &[[f64; 2]], size: f64, ink: Ink) {
        let mut corners = [[0.0; 2]; 8];
        for (corner, at) in corners.iter_mut().zip(outline) {
            *corner = body.point(at.map(|v| (v * size / SCALE) as f32)).map(f64::from);
        }
        self.fill(&corners[..outline.len()], ink);
    }
}

/// The push's part to the lander's right.
fn crosswise(lander: &Motion, push: Push) -> f64 {
    let (sin, cos) = math::sin_cos(f64::from(lander.angle));
    cos * push.impulse[0] + sin * push.impulse[1]
}
