//! The lander's engines: what an action pushes with, and where. A pure function; the nozzles' noise comes from outside.

use dril_stage_api::math;

use super::shape::SCALE;

/// Strength of the main engine, impulse per unit of its offset.
const MAIN_POWER: f64 = 13.0;
/// Strength of the side engines.
const SIDE_POWER: f64 = 0.6;
/// The main engine's nozzle below the origin, world units.
const MAIN_BELOW: f64 = 4.0 / SCALE;
/// The side engines' nozzles beside the origin, world units.
const SIDE_AWAY: f64 = 12.0 / SCALE;
/// Where the side engines push, world units from the origin: the original has one number across and another along.
const SIDE_ABOVE: [f64; 2] = [17.0 / SCALE, 14.0 / SCALE];
/// The side engines fire above this.
const SIDE_THRESHOLD: f64 = 0.5;

/// A push of one engine during one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// Impulse, world axes.
    pub impulse: [f64; 2],
    /// Where it acts, world units.
    pub point: [f64; 2],
    /// Part of the engine's power, 0 (off) or from 0.5 to 1: what fuel is paid for.
    pub power: f64,
}

/// The main engine's push, and that of one of the side engines. `action`: main engine and sideways, each in [-1, 1];
/// `position` and `angle` of the lander's origin; `dispersion`: two draws in [-1, 1).
pub fn fire(action: [f64; 2], position: [f64; 2], angle: f64, dispersion: [f64; 2]) -> [Push; 2] {
    let [along, across] = dispersion.map(|draw| draw / SCALE);
    let (sin, cos) = math::sin_cos(angle);
    let (tip, side) = ([sin, cos], [-cos, sin]);
    let mut pushes = [Push::default(); 2];
    if action[0] > 0.0 {
        let power = 0.5 * (action[0].min(1.0) + 1.0);
        let below = MAIN_BELOW + 2.0 * along;
        let offset = [tip[0] * below + side[0] * across, -tip[1] * below - side[1] * across];
        pushes[0] = Push {
            impulse: offset.map(|v| -v * MAIN_POWER * power),
            point: [position[0] + offset[0], position[1] + offset[1]],
            power,
        };
    }
    if action[1].abs() > SIDE_THRESHOLD {
        let power = action[1].abs().min(1.0);
        let away = 3.0 * across + action[1].signum() * SIDE_AWAY;
        let offset = [tip[0] * along + side[0] * away, -tip[1] * along - side[1] * away];
        pushes[1] = Push {
            impulse: offset.map(|v| -v * SIDE_POWER * power),
            point: [
                position[0] + offset[0] - tip[0] * SIDE_ABOVE[0],
                position[1] + offset[1] + tip[1] * SIDE_ABOVE[1],
            ],
            power,
        };
    }
    pushes
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: [f64; 2] = [10.0, 5.0];

    #[test]
    fn the_main_engine_pushes_up_and_the_side_engines_push_away_from_their_nozzle() {
        let [main, side] = fire([1.0, 0.0], AT, 0.0, [0.0; 2]);
        assert!(main.impulse[0] == 0.0 && (main.impulse[1] - 13.0 * 4.0 / 30.0).abs() < 1e-12, "{main:?}");
        assert_eq!(side, Push::default());
        let [main, side] = fire([0.0, 1.0], AT, 0.0, [0.0; 2]);
        assert_eq!(main, Push::default());
        assert!((side.impulse[0] - 0.6 * 12.0 / 30.0).abs() < 1e-12 && side.impulse[1] == 0.0, "{side:?}");
        assert!(side.point[0] < AT[0] && side.point[1] > AT[1], "{side:?}");
    }

    #[test]
    fn the_main_engine_starts_at_half_power_and_the_side_engines_above_half_the_stick() {
        assert_eq!(fire([1e-9, 0.5], AT, 0.0, [0.0; 2]).map(|push| (push.power * 2.0).round()), [1.0, 0.0]);
        assert_eq!(fire([-1.0, -0.6], AT, 0.0, [0.0; 2]).map(|push| push.power), [0.0, 0.6]);
        assert_eq!(fire([9.0, 9.0], AT, 0.0, [0.0; 2]).map(|push| push.power), [1.0, 1.0]);
    }
}
