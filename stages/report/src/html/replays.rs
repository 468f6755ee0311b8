//! Replays: episodes that a stage of kind `trace` rendered, as six frames, a link to the video, and the driven line,
//! coloured by speed.

use dril_stage_api::StageError;
use dril_stage_api::outcome::{OutputOutcome, PipelineOutcome, StageOutcome, State};
use maud::{Markup, PreEscaped, html};

use super::csvs::Csv;
use super::figures::{embedded, frame};
use super::{Room, Section, is_replay, link, read};
use crate::number::fixed;

/// Largest size of the map in pixels.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
/// Margin around the map.
const MARGIN: f64 = 12.0;
/// Height of the legend below it.
const LEGEND: f64 = 30.0;
/// From slow to fast: five colours of Okabe and Ito, in order of their warmth.
const COLOURS: [&str; 5] = ["#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00"];

/// The section; `None` if no stage rendered an episode.
pub(crate) fn section(outcome: &PipelineOutcome, room: &mut Room) -> Result<Option<Section>, StageError> {
    let drawn = |stage: &&StageOutcome| is_replay(stage) && stage.state == State::Done;
    let mut bodies = Vec::new();
    for stage in outcome.stages.iter().filter(drawn) {
        bodies.extend(replay(stage, room)?);
    }
    let body = html! { @for body in &bodies { (body) } };
    Ok((!bodies.is_empty()).then_some(Section { anchor: "replays", title: "Replays", body }))
}

fn output<'s>(stage: &'s StageOutcome, name: &str) -> Option<&'s OutputOutcome> {
    stage.outputs.iter().find(|output| output.name == name)
}

fn replay(stage: &StageOutcome, room: &mut Room) -> Result<Option<Markup>, StageError> {
    let csv = |name: &str| output(stage, name).map(read).transpose().map(|bytes| Csv::parse(&bytes?));
    let (Some(steps), map) = (csv("steps")?, csv("map")?) else { return Ok(None) };
    let Some(episode) = Episode::first(&steps, map.as_ref()) else { return Ok(None) };
    let title =
        format!("Seed {}: score {} after {} steps", episode.seed, fixed(episode.score, 1), episode.steps);
    let drawn = episode.svg(&title);
    let has_line = drawn.is_some();
    let line = drawn.filter(|svg| room.take(svg.len())).map(PreEscaped);
    let has_strip = output(stage, "strip").is_some();
    let strip = match output(stage, "strip") {
        Some(strip) => embedded(&format!("Six moments of it. {title}"), strip, room)?,
        None => None,
    };
    Ok(Some(html! {
        figure class="fit" {
            @if let Some(line) = &line { (frame(&title, line)) }
            @if let Some(strip) = &strip { (frame(&format!("{title}: six moments"), strip)) }
            @if has_line && line.is_none() { p class="quiet" { "The driven line is too large for this page." } }
            @if has_strip && strip.is_none() { p class="quiet" { "The six moments are too large for this page." } }
            figcaption {
                (title) ". Stage " code { (stage.id) }
                @for name in ["video", "strip"] {
                    @if let Some(output) = output(stage, name).filter(|output| output.file.is_some()) {
                        ", " (link(output))
                    }
                }
            }
        }
    }))
}

/// The first episode of a trace.
struct Episode {
    seed: String,
    score: f64,
    steps: usize,
    /// Position and speed after each step; empty if the environment has no poses.
    poses: Vec<[f64; 3]>,
    lines: Vec<Vec<[f64; 2]>>,
}

impl Episode {
    fn first(steps: &Csv, map: Option<&Csv>) -> Option<Self> {
        let number = |row: &Vec<String>, name: &str| steps.cell(row, name).parse::<f64>().ok();
        let rows: Vec<&Vec<String>> =
            steps.rows.iter().take_while(|row| steps.cell(row, "episode") == "0").collect();
        let last = rows.last()?;
        let pose = |row: &&Vec<String>| {
            Some([number(row, "x")?, number(row, "y")?, number(row, "speed")?])
                .filter(|pose| pose.iter().all(|value| value.is_finite()))
        };
        let mut lines: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
        for row in map.iter().flat_map(|map| &map.rows) {
            let cell = |name: &str| map.map_or("", |map| map.cell(row, name));
            let (Ok(x), Ok(y)) = (cell("x").parse::<f64>(), cell("y").parse::<f64>()) else { continue };
            match lines.last_mut().filter(|(name, _)| name == cell("line")) {
                Some((_, points)) => points.push([x, y]),
                None => lines.push((cell("line").to_owned(), vec![[x, y]])),
            }
        }
        Some(Self {
            seed: steps.cell(last, "seed").to_owned(),
            score: number(last, "score")?,
            steps: rows.len(),
            poses: rows.iter().map_while(pose).collect(),
            lines: lines.into_iter().map(|(_, points)| points).collect(),
        })
    }

    /// The driven line on the map; `None` without poses.
    fn svg(&self, title: &str) -> Option<String> {
        if self.poses.len() < 2 {
            return None;
        }
        let all = || {
            let poses = self.poses.iter().map(|[x, y, _]| [*x, *y]);
            self.lines.iter().flatten().copied().chain(poses)
        };
        let ends = |axis: usize| {
            all().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
                (low.min(point[axis]), high.max(point[axis]))
            })
        };
        let ((left, right), (bottom, top)) = (ends(0), ends(1));
        let scale = (WIDTH - 2.0 * MARGIN) / (right - left).max(1e-9);
        let scale = scale.min((HEIGHT - 2.0 * MARGIN) / (top - bottom).max(1e-9));
        let height = (top - bottom) * scale + 2.0 * MARGIN;
        let indent = (WIDTH - (right - left) * scale) / 2.0;
        let place = |[x, y]: [f64; 2]| [indent + (x - left) * scale, MARGIN + (top - y) * scale];
        let fastest = self.poses.iter().map(|pose| pose[2]).fold(0.0, f64::max).max(1e-9);
        let legend = legend(height + 4.0, fastest);
        let text = html! {
            svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {WIDTH} {}", (height + LEGEND).ceil()))
                width=(WIDTH) role="img" font-family="system-ui,sans-serif" font-size="11" {
                title { (title) }
                desc { "The driven line on the map, coloured by speed." }
                (self.map(&place))
                (self.way(&place, fastest))
                (legend)
            }
        };
        Some(text.into_string())
    }

    fn map(&self, place: &impl Fn([f64; 2]) -> [f64; 2]) -> Markup {
        let closed = |points: &&Vec<[f64; 2]>| points.len() > 2 && points.first() == points.last();
        let data = |points: &Vec<[f64; 2]>| path(points.iter().map(|point| place(*point)));
        // Two closed lines are the sides of a road: what lies between them is filled.
        let road: String = self.lines.iter().filter(closed).map(data).collect();
        let open: String = self.lines.iter().filter(|points| !closed(points)).map(data).collect();
        html! {
            @if !road.is_empty() {
                path d=(road) fill="#8c8c8c" fill-opacity=".28" fill-rule="evenodd" stroke="#8c8c8c" stroke-width=".5" {}
            }
            @if !open.is_empty() { path d=(open) fill="none" stroke="#8c8c8c" stroke-width="1.5" {} }
        }
    }

    fn way(&self, place: &impl Fn([f64; 2]) -> [f64; 2], fastest: f64) -> Markup {
        let mut pieces: Vec<(usize, Vec<[f64; 2]>)> = Vec::new();
        for pose in &self.poses {
            let (point, bin) = (place([pose[0], pose[1]]), bin(pose[2], fastest));
            match pieces.last_mut() {
                Some((last, points)) if *last == bin => points.push(point),
                // Pieces share a point, so that the line has no gaps.
                Some((_, points)) => {
                    points.push(point);
                    pieces.push((bin, vec![point]));
                }
                None => pieces.push((bin, vec![point])),
            }
        }
        let [x, y] = place([self.poses[0][0], self.poses[0][1]]);
        html! {
            @for (bin, colour) in COLOURS.iter().enumerate() {
                @let data: String =
                    pieces.iter().filter(|(at, _)| *at == bin).map(|(_, points)| path(points.iter().copied())).collect();
                @if !data.is_empty() {
                    path d=(data) fill="none" stroke=(colour) stroke-width="2" stroke-linejoin="round" {}
                }
            }
            circle cx=(fixed(x, 1)) cy=(fixed(y, 1)) r="4" fill="none" stroke="currentColor" stroke-width="1.5" {}
        }
    }
}

fn bin(speed: f64, fastest: f64) -> usize {
    ((speed / fastest * COLOURS.len() as f64) as usize).min(COLOURS.len() - 1)
}

fn legend(top: f64, fastest: f64) -> Markup {
    let share =
        |n: usize| fixed(fastest * n as f64 / COLOURS.len() as f64, if fastest < 10.0 { 1 } else { 0 });
    let (row, text) = (fixed(top + 6.0, 1), fixed(top + 15.0, 1));
    html! {
        text x=(MARGIN) y=(text) fill="currentColor" { "speed (units/s)" }
        @for (n, colour) in COLOURS.iter().enumerate() {
            @let x = 110.0 + 84.0 * n as f64;
            rect x=(x) y=(row) width="18" height="10" fill=(colour) {}
            text x=(x + 24.0) y=(text) fill="currentColor" { (share(n)) "–" (share(n + 1)) }
        }
        circle cx="548" cy=(fixed(top + 11.0, 1)) r="4" fill="none" stroke="currentColor" stroke-width="1.5" {}
        text x="558" y=(text) fill="currentColor" { "start" }
    }
}

/// An SVG path through these points, in relative steps of tenths of a pixel.
fn path(points: impl Iterator<Item = [f64; 2]>) -> String {
    let mut data = String::new();
    let mut before: Option<[i64; 2]> = None;
    for point in points {
        let at = point.map(|value| (value * 10.0).round() as i64);
        let tenth = |value: i64| {
            format!("{}{}.{}", if value < 0 { "-" } else { "" }, value.abs() / 10, value.abs() % 10)
        };
        match before {
            None => data.push_str(&format!("M{} {}", tenth(at[0]), tenth(at[1]))),
            Some(last) if last == at => continue,
            Some(last) => data.push_str(&format!("l{} {}", tenth(at[0] - last[0]), tenth(at[1] - last[1]))),
        }
        before = Some(at);
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(text: &str) -> Csv {
        Csv::parse(text.as_bytes()).unwrap()
    }

    #[test]
    fn the_way_of_the_first_episode_is_drawn_over_the_map_in_the_colours_of_its_speed() {
        let steps = csv(
            "step,episode,seed,score,x,y,speed\n0,0,7,-0.1,0,0,1\n1,0,7,3.5,10,0,10\n2,0,7,4,20,5,10\n3,1,8,9,0,0,1\n",
        );
        let map = csv("line,x,y\nleft,-5,-5\nleft,25,-5\nleft,25,15\nleft,-5,-5\n");
        let episode = Episode::first(&steps, Some(&map)).unwrap();
        assert_eq!((episode.seed.as_str(), episode.score, episode.steps), ("7", 4.0, 3));
        let svg = episode.svg("a lap").unwrap();
        assert!(svg.contains(COLOURS[0]) && svg.contains(COLOURS[4]), "{svg}");
        assert!(svg.contains("evenodd") && svg.contains("<title>a lap</title>"), "{svg}");
    }

    #[test]
    fn an_environment_without_poses_has_no_way() {
        let steps = csv("step,episode,seed,score,x,y,speed\n0,0,7,-0.1,,,\n1,0,7,3.5,,,\n");
        let episode = Episode::first(&steps, None).unwrap();
        assert_eq!(episode.svg("a game"), None);
    }

    #[test]
    fn a_path_is_written_in_steps_and_stands_still_nowhere() {
        assert_eq!(path([[1.0, 2.0], [1.0, 2.0], [0.5, 2.25]].into_iter()), "M1.0 2.0l-0.5 0.3");
    }

    #[test]
    fn the_fastest_moment_has_the_last_colour() {
        assert_eq!((bin(0.0, 50.0), bin(9.9, 50.0), bin(50.0, 50.0)), (0, 0, 4));
    }
}
