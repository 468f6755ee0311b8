//! The units of each counted resource (`--resources gpu=2`), with their names.

use std::collections::BTreeSet;
use std::path::Path;

use super::terminal::print_error;
use crate::error::{Error, ErrorKind};
use crate::exec::Units;
use crate::fsx;
use crate::spec::limits::MOST_OF_ONE;
use crate::spec::suggest;

/// The variable that lists the GPUs that a program may use; that of this program limits its stages.
pub(super) const GPUS: &str = "CUDA_VISIBLE_DEVICES";

/// The units of each resource. On a cluster the scheduler decides how many GPUs there are, unless it is given, and which of
/// them a stage uses.
///
/// # Errors
/// More GPUs than `CUDA_VISIBLE_DEVICES` lists, or a resource is given twice.
pub(super) fn units(given: &[(String, u32)], on_cluster: bool) -> Result<Units, Error> {
    if on_cluster {
        return units_with(given, None, usize::try_from(MOST_OF_ONE).unwrap_or(usize::MAX));
    }
    let visible = std::env::var(GPUS).ok().filter(|list| !list.trim().is_empty());
    units_with(given, visible.as_deref(), cards())
}

fn units_with(given: &[(String, u32)], visible: Option<&str>, cards: usize) -> Result<Units, Error> {
    let visible: Option<Vec<String>> =
        visible.map(|list| list.split(',').map(|unit| unit.trim().to_owned()).collect());
    let numbered = |count: usize| (0..count).map(|number| number.to_string()).collect::<Vec<_>>();
    let mut units = Units::new();
    for (name, count) in given {
        let count = *count as usize;
        let of_it = match &visible {
            Some(visible) if name == "gpu" && count > visible.len() => {
                let message = format!("`--resources gpu={count}`, but {GPUS} lists {}", visible.len());
                return Err(Error::new(ErrorKind::Usage, message));
            }
            Some(visible) if name == "gpu" => visible[..count].to_vec(),
            _ => numbered(count),
        };
        if units.insert(name.clone(), of_it).is_some() {
            return Err(Error::new(ErrorKind::Usage, format!("`--resources` gives `{name}` twice")));
        }
    }
    if !units.contains_key("gpu") {
        units.insert("gpu".to_owned(), visible.unwrap_or_else(|| numbered(cards.max(1))));
    }
    Ok(units)
}

/// Warns of resources that are given and that no stage uses: usually a misspelt name, and the stages wait for one unit.
pub(super) fn warn_of_unused(given: &[(String, u32)], known: &BTreeSet<String>) {
    for (name, count) in given.iter().filter(|(name, _)| !known.contains(name)) {
        let hint = suggest::hint(name, "the resources of the stages", known.iter().map(String::as_str));
        print_error(&format!(
            "warning: `--resources {name}={count}`: no stage uses this resource\n  = hint: {hint}\n"
        ));
    }
}

/// The number of CUDA GPUs, from `/dev`.
fn cards() -> usize {
    let names = fsx::list(Path::new("/dev")).unwrap_or_default().into_iter();
    let is_card = |name: &str| {
        name.strip_prefix("nvidia")
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
    };
    names.filter(|path| path.file_name().and_then(|name| name.to_str()).is_some_and(is_card)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpus_are_those_that_this_program_may_use() {
        let of = |given: &[(&str, u32)], visible, cards| {
            let given: Vec<_> = given.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
            units_with(&given, visible, cards)
                .map(|units| units["gpu"].join(" "))
                .map_err(|error| error.to_string())
        };
        assert_eq!(of(&[], None, 0).as_deref(), Ok("0"));
        assert_eq!(of(&[], None, 4).as_deref(), Ok("0 1 2 3"));
        assert_eq!(of(&[], Some("2, 5"), 8).as_deref(), Ok("2 5"));
        assert_eq!(of(&[("gpu", 1), ("licence", 3)], Some("2,5"), 8).as_deref(), Ok("2"));
        assert!(of(&[("gpu", 3)], Some("2,5"), 8).unwrap_err().contains("CUDA_VISIBLE_DEVICES lists 2"));
        assert!(of(&[("gpu", 1), ("gpu", 2)], None, 8).unwrap_err().contains("twice"));
    }
}
