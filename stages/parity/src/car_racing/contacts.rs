//! The tile rules alone: contacts and visits of recorded poses, against the recorded ones.

use super::playback::Playback;
use super::recording::Recordings;
use crate::error::CheckError;
use crate::report::Report;

/// Largest part of the moments at which a wheel may touch another number of tiles, percent: recorded poses are rounded,
/// and a wheel within a thousandth of an edge may fall to either side.
const CONTACTS: f64 = 1.0;

/// Adds rows for visits and contacts.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let (mut visits, mut contacts) = (vec![], vec![]);
    for script in recordings.scripts() {
        for seed in recordings.seeds() {
            let Some(run) = recordings.run(seed, &script)? else { continue };
            let mut playback = Playback::new(&run, recordings.track(seed)?);
            let (mut visit_error, mut differ) = (0.0_f64, 0);
            for moment in 0..run.visited.rows() {
                playback.go_to(moment);
                let (tiles, touched) = playback.tiles();
                visit_error = visit_error.max((tiles.visits() as f64 - run.visited.values[moment]).abs());
                let under = touched.under.map(f64::from);
                differ += usize::from(under != *run.contacts.row(moment));
            }
            visits.push(visit_error);
            contacts.push(100.0 * differ as f64 / run.visited.rows() as f64);
        }
    }
    report.add("recorded poses", "tiles visited", &visits, Some(0.0));
    report.add("recorded poses", "moments with other contacts, %", &contacts, Some(CONTACTS));
    Ok(())
}
