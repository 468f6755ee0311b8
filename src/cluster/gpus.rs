//! The GPUs of a stage on its node. The engine counts how many it has; which ones, the scheduler decides.

use crate::exec::Units;

/// The name of the resource.
pub(super) const NAME: &str = "gpu";

/// The units that a stage holds on this node: the first GPUs that the job may use by its `CUDA_VISIBLE_DEVICES`, counted from 0
/// where the scheduler sets none.
///
/// # Errors
/// The job may use fewer than the stage needs.
pub(super) fn here(units: &Units, visible: Option<&str>) -> Result<Units, String> {
    let mut units = units.clone();
    let Some(held) = units.get_mut(NAME) else { return Ok(units) };
    let listed = visible.map(str::trim).filter(|list| !list.is_empty());
    *held = match listed {
        None => (0..held.len()).map(|number| number.to_string()).collect(),
        Some(list) => {
            let own: Vec<String> = list.split(',').map(|unit| unit.trim().to_owned()).collect();
            let Some(own) = own.get(..held.len()) else {
                return Err(format!(
                    "it needs {} GPUs, and its job may use {} (`CUDA_VISIBLE_DEVICES={list}`): check how the job requests \
                     GPUs",
                    held.len(),
                    own.len()
                ));
            };
            own.to_vec()
        }
    };
    Ok(units)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_has_the_gpus_that_the_scheduler_assigned() {
        let units = |gpus: &[&str]| {
            let gpus = gpus.iter().map(|unit| (*unit).to_owned()).collect();
            Units::from([(NAME.to_owned(), gpus), ("licence".to_owned(), vec!["7".to_owned()])])
        };
        let counted = units(&["17", "18"]);
        assert_eq!(here(&counted, Some("4,6,7")), Ok(units(&["4", "6"])));
        assert_eq!(here(&counted, Some("GPU-a, GPU-b")), Ok(units(&["GPU-a", "GPU-b"])));
        assert_eq!(here(&counted, None), Ok(units(&["0", "1"])));
        assert_eq!(here(&counted, Some("")), Ok(units(&["0", "1"])));
        let error = here(&counted, Some("3")).unwrap_err();
        assert!(error.starts_with("it needs 2 GPUs, and its job may use 1"), "{error}");
        let none = Units::from([("licence".to_owned(), vec!["7".to_owned()])]);
        assert_eq!(here(&none, Some("3")), Ok(none.clone()));
    }
}
