//! Cuts shapes at the edges of a plot: what lies outside is left out, and what crosses an edge ends on it.

/// A place on the canvas, in tenths of a pixel.
pub(crate) type Pixel = (i32, i32);

/// The edges of a plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) left: i32,
    pub(crate) top: i32,
    pub(crate) right: i32,
    pub(crate) bottom: i32,
}

impl Frame {
    pub(crate) fn contains(self, (x, y): Pixel) -> bool {
        (self.left..=self.right).contains(&x) && (self.top..=self.bottom).contains(&y)
    }

    /// The place inside that is nearest.
    fn nearest(self, (x, y): Pixel) -> Pixel {
        (x.clamp(self.left, self.right), y.clamp(self.top, self.bottom))
    }

    /// The part of a straight line that lies inside (Liang and Barsky, ACM Transactions on Graphics 3, 1984).
    pub(crate) fn segment(self, from: Pixel, to: Pixel) -> Option<(Pixel, Pixel)> {
        let (dx, dy) = (f64::from(to.0) - f64::from(from.0), f64::from(to.1) - f64::from(from.1));
        let room = |a: i32, b: i32| f64::from(a) - f64::from(b);
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for (step, room) in [
            (-dx, room(from.0, self.left)),
            (dx, room(self.right, from.0)),
            (-dy, room(from.1, self.top)),
            (dy, room(self.bottom, from.1)),
        ] {
            if step == 0.0 && room < 0.0 {
                return None;
            } else if step < 0.0 {
                enter = enter.max(room / step);
            } else if step > 0.0 {
                leave = leave.min(room / step);
            }
        }
        if enter > leave {
            return None;
        }
        let at = |share: f64| {
            let along = |from: i32, step: f64| (f64::from(from) + share * step).round() as i32;
            self.nearest((along(from.0, dx), along(from.1, dy)))
        };
        let start = if self.contains(from) { from } else { at(enter) };
        let end = if self.contains(to) { to } else { at(leave) };
        // A line that only touches a corner is not seen.
        (start != end || self.contains(from) || self.contains(to)).then_some((start, end))
    }

    /// A line as pieces that lie inside. It breaks where a point is `None`; a piece may be a single point.
    pub(crate) fn line(self, points: impl IntoIterator<Item = Option<Pixel>>) -> Vec<Vec<Pixel>> {
        let mut pieces: Vec<Vec<Pixel>> = Vec::new();
        let mut before = None;
        for point in points {
            match (before, point) {
                (None, Some(point)) if self.contains(point) => pieces.push(vec![point]),
                (Some(from), Some(to)) => match (self.segment(from, to), pieces.last_mut()) {
                    (Some((_, end)), Some(piece)) if self.contains(from) => piece.push(end),
                    (Some((start, end)), _) => pieces.push(vec![start, end]),
                    (None, _) => {}
                },
                _ => {}
            }
            before = point;
        }
        pieces
    }

    /// The part of a rectangle that lies inside, from its left upper to its right lower corner.
    pub(crate) fn rectangle(self, a: Pixel, b: Pixel) -> Option<[Pixel; 2]> {
        let from = (a.0.min(b.0).max(self.left), a.1.min(b.1).max(self.top));
        let to = (a.0.max(b.0).min(self.right), a.1.max(b.1).min(self.bottom));
        (from.0 < to.0 && from.1 < to.1).then_some([from, to])
    }

    /// The part of a polygon that lies inside, edge by edge (Sutherland and Hodgman, Communications of the ACM 17, 1974).
    /// Where it falls apart, its parts are connected along an edge.
    pub(crate) fn polygon(self, mut corners: Vec<Pixel>) -> Vec<Pixel> {
        // Each edge as the distance from it, positive inside.
        let edges: [&dyn Fn(Pixel) -> i32; 4] =
            [&|(x, _)| x - self.left, &|(x, _)| self.right - x, &|(_, y)| y - self.top, &|(_, y)| {
                self.bottom - y
            }];
        for inside in edges {
            let mut kept = Vec::with_capacity(corners.len());
            let mut before = corners.last().copied();
            for to in corners {
                if let Some(from) = before {
                    let (a, b) = (inside(from), inside(to));
                    if (a < 0) != (b < 0) {
                        let share = f64::from(a) / (f64::from(a) - f64::from(b));
                        let along = |from: i32, to: i32| {
                            let (from, to) = (f64::from(from), f64::from(to));
                            (from + share * (to - from)).round() as i32
                        };
                        kept.push((along(from.0, to.0), along(from.1, to.1)));
                    }
                    if b >= 0 {
                        kept.push(to);
                    }
                }
                before = Some(to);
            }
            corners = kept;
        }
        corners
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FRAME: Frame = Frame { left: 0, top: 0, right: 100, bottom: 50 };

    #[test]
    fn a_segment_ends_on_the_edges_that_it_crosses() {
        assert_eq!(FRAME.segment((10, 10), (20, 20)), Some(((10, 10), (20, 20))));
        assert_eq!(FRAME.segment((-50, 25), (150, 25)), Some(((0, 25), (100, 25))));
        assert_eq!(FRAME.segment((50, 25), (50, 1_000_000_000)), Some(((50, 25), (50, 50))));
        assert_eq!(FRAME.segment((-10, -20), (30, 60)), Some(((0, 0), (25, 50))));
        assert_eq!(FRAME.segment((-10, 10), (10, -10)), None, "it touches a corner");
        assert_eq!(
            FRAME.segment((-10, 10), (0, 10)),
            Some(((0, 10), (0, 10))),
            "a point on the edge is inside"
        );
        assert_eq!(FRAME.segment((-10, 60), (110, 60)), None);
    }

    #[test]
    fn a_line_goes_on_where_it_enters_again_and_breaks_where_a_point_is_missing() {
        let line = |points: &[Option<Pixel>]| FRAME.line(points.iter().copied());
        let inside = [Some((10, 10)), Some((20, 10)), Some((20, 10))];
        assert_eq!(line(&inside), [[(10, 10), (20, 10), (20, 10)]]);
        let leaves = [Some((10, 10)), Some((20, -10)), Some((30, 10)), Some((40, 10))];
        assert_eq!(line(&leaves), [vec![(10, 10), (15, 0)], vec![(25, 0), (30, 10), (40, 10)]]);
        assert_eq!(
            line(&[Some((1, 1)), None, Some((3, 3)), Some((4, 4))]),
            [vec![(1, 1)], vec![(3, 3), (4, 4)]]
        );
        assert_eq!(line(&[Some((-10, 25)), Some((110, 25))]), [[(0, 25), (100, 25)]], "no point inside");
        assert!(line(&[Some((-10, 25)), Some((-5, 25)), None]).is_empty());
    }

    #[test]
    fn a_rectangle_outside_is_none_and_one_across_an_edge_is_smaller() {
        assert_eq!(FRAME.rectangle((10, 80), (20, -5)), Some([(10, 0), (20, 50)]));
        assert_eq!(FRAME.rectangle((10, -5), (20, 0)), None);
        assert_eq!(FRAME.rectangle((-20, 10), (-10, 20)), None);
    }

    #[test]
    fn a_polygon_inside_is_kept_corner_by_corner_and_one_across_an_edge_is_cut_there() {
        let inside = vec![(10, 10), (20, 10), (20, 20), (20, 20)];
        assert_eq!(FRAME.polygon(inside.clone()), inside);
        assert_eq!(
            FRAME.polygon(vec![(40, 25), (60, 25), (50, 75)]),
            [(45, 50), (40, 25), (60, 25), (55, 50)]
        );
        assert_eq!(FRAME.polygon(vec![(200, 10), (300, 10), (300, 20)]), []);
        let around = FRAME.polygon(vec![(-900, -900), (900, -900), (900, 900), (-900, 900)]);
        assert!(
            [(0, 0), (100, 0), (100, 50), (0, 50)].iter().all(|corner| around.contains(corner)),
            "{around:?}"
        );
    }

    proptest! {
        #[test]
        fn nothing_is_left_outside(points in prop::collection::vec((-300..400_i32, -300..400_i32), 2..12)) {
            let pieces = FRAME.line(points.iter().copied().map(Some));
            prop_assert!(pieces.iter().flatten().all(|at| FRAME.contains(*at)), "{pieces:?}");
            // Every point inside is there.
            let all: Vec<&Pixel> = pieces.iter().flatten().collect();
            prop_assert!(points.iter().filter(|at| FRAME.contains(**at)).all(|at| all.contains(&at)));
            let polygon = FRAME.polygon(points);
            prop_assert!(polygon.iter().all(|at| FRAME.contains(*at)), "{polygon:?}");
        }
    }
}
