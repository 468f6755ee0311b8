//! Stages as jobs of a cluster, by a simulated one: many nodes, a busy `sbatch`, lost answers and lost jobs.
//! `tests/slurm/run.sh` does the same on a real Slurm.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dril_pipe::cluster::{ClusterRunner, JobId, Pace, Scheduler, Seen, Site, State, Submission, SubmitError};
use dril_pipe::exec::Options;
use dril_pipe::settings::ClusterSettings;
use serde_json::{Value, json};

use crate::lab::{Lab, Ran};
use crate::scenario::StageLine;

/// A cluster whose nodes write at once what a stage would: the name of the stage.
#[derive(Default)]
struct Simulated {
    jobs: Mutex<BTreeMap<JobId, (String, Seen)>>,
    next: AtomicUsize,
    submissions: AtomicUsize,
    lists: AtomicUsize,
    looks: AtomicUsize,
    /// So many submissions are refused for now.
    busy: AtomicUsize,
    /// So many are taken, and the answer is lost.
    unanswered: AtomicUsize,
    /// So many jobs vanish with their node.
    lost: AtomicUsize,
    /// So many pilots vanish with the stage that they took, or fail before they begin.
    lost_pilots: AtomicUsize,
    failed_pilots: AtomicUsize,
    /// Pilots that run now.
    pilots: AtomicUsize,
    nodes: Mutex<Option<Sender<(JobId, PathBuf)>>>,
}

fn one_less(count: &AtomicUsize) -> bool {
    count.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_ok()
}

impl Simulated {
    /// With threads that stand for nodes.
    fn start(threads: usize) -> Arc<Self> {
        let (sender, receiver) = channel::<(JobId, PathBuf)>();
        let cluster = Arc::new(Self { nodes: Mutex::new(Some(sender)), ..Self::default() });
        let receiver = Arc::new(Mutex::new(receiver));
        for _ in 0..threads {
            let (cluster, receiver) = (Arc::downgrade(&cluster), Arc::clone(&receiver));
            std::thread::spawn(move || {
                loop {
                    let next = receiver.lock().unwrap().recv();
                    let Ok((job, folder)) = next else { return };
                    let Some(cluster) = cluster.upgrade() else { return };
                    cluster.work(&job, &folder);
                }
            });
        }
        cluster
    }

    fn work(&self, job: &JobId, folder: &Path) {
        let word = if folder.join("pilot.json").is_file() {
            self.pilots.fetch_add(1, Ordering::SeqCst);
            let word = self.pilot(job, folder);
            self.pilots.fetch_sub(1, Ordering::SeqCst);
            word
        } else if one_less(&self.lost) {
            "NODE_FAIL"
        } else {
            make(job, folder);
            "COMPLETED"
        };
        if let Some((_, seen)) = self.jobs.lock().unwrap().get_mut(job) {
            seen.state = State::Over(word.to_owned());
        }
    }

    /// Takes stages until it is asked to end.
    fn pilot(&self, job: &JobId, folder: &Path) -> &'static str {
        if one_less(&self.failed_pilots) {
            return "FAILED";
        }
        std::fs::write(folder.join("job"), job).unwrap();
        let orders: Value =
            serde_json::from_slice(&std::fs::read(folder.join("pilot.json")).unwrap()).unwrap();
        let queue = folder.parent().unwrap().join(format!("queue-{}", orders["class"].as_str().unwrap()));
        while !folder.join("end").exists() {
            for entry in std::fs::read_dir(&queue).unwrap() {
                let name = entry.unwrap().file_name().into_string().unwrap();
                let taken = folder.join("taken").join(&name);
                if std::fs::rename(queue.join(&name), &taken).is_err() {
                    continue;
                }
                if one_less(&self.lost_pilots) {
                    return "NODE_FAIL";
                }
                let key = name.split_once('-').unwrap().1;
                make(job, &Path::new(orders["jobs"].as_str().unwrap()).join(key));
                std::fs::remove_file(taken).unwrap();
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        std::fs::write(folder.join("ended"), "").unwrap();
        "COMPLETED"
    }
}

/// Writes what a node does: the stage's outputs, which are its name, how it ended, and the notice.
fn make(job: &JobId, folder: &Path) {
    let handoff: Value =
        serde_json::from_slice(&std::fs::read(folder.join("handoff.json")).unwrap()).unwrap();
    for output in handoff["job"]["outputs"].as_object().unwrap().values() {
        std::fs::write(output["path"].as_str().unwrap(), handoff["job"]["stage"].as_str().unwrap()).unwrap();
    }
    let ended = json!({ "version": 1, "job": job, "node": "n1", "how": "done", "messages": [] });
    std::fs::write(folder.join(".ended"), ended.to_string()).unwrap();
    std::fs::rename(folder.join(".ended"), folder.join("ended.json")).unwrap();
    let notice = folder.parent().unwrap().join("ended").join(folder.file_name().unwrap());
    std::fs::write(notice, job).unwrap();
}

impl Scheduler for Simulated {
    fn name(&self) -> &str {
        "Slurm"
    }

    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError> {
        self.submissions.fetch_add(1, Ordering::SeqCst);
        if one_less(&self.busy) {
            return Err(SubmitError::Busy("socket timed out".to_owned()));
        }
        let job = self.next.fetch_add(1, Ordering::SeqCst).to_string();
        let seen = Seen { state: State::Running, node: "n1".to_owned() };
        self.jobs.lock().unwrap().insert(job.clone(), (submission.name.clone(), seen));
        let nodes = self.nodes.lock().unwrap();
        nodes.as_ref().unwrap().send((job.clone(), submission.folder.clone())).unwrap();
        if one_less(&self.unanswered) {
            Err(SubmitError::Busy("socket timed out".to_owned()))
        } else {
            Ok(job)
        }
    }

    fn list(&self) -> Result<BTreeMap<JobId, Seen>, String> {
        self.lists.fetch_add(1, Ordering::SeqCst);
        Ok(self.jobs.lock().unwrap().iter().map(|(job, (_, seen))| (job.clone(), seen.clone())).collect())
    }

    fn look(&self, job: &JobId) -> Result<Option<Seen>, String> {
        self.looks.fetch_add(1, Ordering::SeqCst);
        Ok(self.jobs.lock().unwrap().get(job).map(|(_, seen)| seen.clone()))
    }

    fn find(&self, name: &str) -> Result<Option<JobId>, String> {
        let jobs = self.jobs.lock().unwrap();
        Ok(jobs.iter().find(|(_, (known, _))| known == name).map(|(job, _)| job.clone()))
    }

    fn stop(&self, _: &[JobId]) -> Result<(), String> {
        Ok(())
    }

    fn cancel(&self, _: &[JobId]) -> Result<(), String> {
        Ok(())
    }
}

fn run(cluster: &Arc<Simulated>, count: usize) -> (Lab, Ran) {
    run_with(cluster, count, ClusterSettings::default())
}

fn run_with(cluster: &Arc<Simulated>, count: usize, settings: ClusterSettings) -> (Lab, Ran) {
    let lab = Lab::new();
    let settings = ClusterSettings { local: Some(Vec::new()), ..settings };
    let pace = Pace {
        look: Duration::from_millis(20),
        ask: Duration::from_millis(200),
        settle: Duration::from_millis(100),
    };
    let scheduler: Arc<dyn Scheduler> = Arc::<Simulated>::clone(cluster);
    let site = Site { pace, ..Site::new(lab.store.root()).unwrap() };
    let runner = ClusterRunner::new(scheduler, settings, site).unwrap();
    let stages: Vec<StageLine> = (0..count)
        .map(|number| StageLine::new(&format!("s{number}"), "emit", json!({ "text": number.to_string() })))
        .collect();
    let options = Options { threads: 1000, ..Options::default() };
    let ran = lab.run_with(&stages, &runner, &options, &AtomicBool::new(false));
    (lab, ran)
}

#[test]
fn many_stages_on_many_nodes_ask_the_scheduler_rarely() {
    let count: usize = std::env::var("DRIL_TEST_STAGES").map_or(200, |count| count.parse().unwrap());
    let cluster = Simulated::start(4);
    let began = Instant::now();
    let (_lab, ran) = run(&cluster, count);
    let took = began.elapsed();
    assert_eq!(ran.counts(), [count, 0, 0, 0, 0], "{}", ran.error());
    assert_eq!(cluster.submissions.load(Ordering::SeqCst), count, "each stage is one job");
    let asked = cluster.lists.load(Ordering::SeqCst) as u128;
    assert!(asked <= took.as_millis() / 200 + 1, "{asked} questions in {took:?}");
    println!("{count} stages in {took:?}, {asked} lists, {} looks", cluster.looks.load(Ordering::SeqCst));
}

#[test]
fn a_busy_scheduler_a_lost_answer_and_a_lost_node_cost_time_only() {
    let cluster = Simulated::start(2);
    cluster.busy.store(2, Ordering::SeqCst);
    cluster.unanswered.store(1, Ordering::SeqCst);
    cluster.lost.store(2, Ordering::SeqCst);
    let (_lab, ran) = run(&cluster, 6);
    assert_eq!(ran.counts(), [6, 0, 0, 0, 0], "{}", ran.error());
    assert_eq!(cluster.next.load(Ordering::SeqCst), 8, "six stages, and two jobs that were lost");
}

#[test]
fn a_stage_whose_jobs_are_lost_again_and_again_fails() {
    let cluster = Simulated::start(1);
    cluster.lost.store(usize::MAX, Ordering::SeqCst);
    let (_lab, ran) = run(&cluster, 1);
    assert_eq!(ran.counts(), [0, 0, 1, 0, 0]);
    assert!(ran.error().contains("ended on node `n1` without a result (NODE_FAIL)"), "{}", ran.error());
}

fn two_pilots() -> ClusterSettings {
    ClusterSettings { pilots: Some(2), ..ClusterSettings::default() }
}

#[test]
fn small_stages_run_in_two_pilots_that_end_with_the_run() {
    let cluster = Simulated::start(4);
    let (lab, ran) = run_with(&cluster, 60, two_pilots());
    assert_eq!(ran.counts(), [60, 0, 0, 0, 0], "{}", ran.error());
    let submissions = cluster.submissions.load(Ordering::SeqCst);
    assert!((1..=2).contains(&submissions), "{submissions} jobs, expected two pilots");
    let began = Instant::now();
    while cluster.pilots.load(Ordering::SeqCst) > 0 {
        assert!(began.elapsed() < Duration::from_secs(20), "a pilot still runs after the run");
        std::thread::sleep(Duration::from_millis(5));
    }
    let left = std::fs::read_dir(lab.store.root().join("slurm-v1")).unwrap().count();
    assert_eq!(left, 1, "only the folder of notices is left");
}

#[test]
fn a_stage_whose_pilot_is_lost_has_a_job_of_its_own_and_the_pilot_is_replaced() {
    let cluster = Simulated::start(4);
    cluster.lost_pilots.store(2, Ordering::SeqCst);
    let (_lab, ran) = run_with(&cluster, 20, two_pilots());
    assert_eq!(ran.counts(), [20, 0, 0, 0, 0], "{}", ran.error());
    let submissions = cluster.submissions.load(Ordering::SeqCst);
    assert!((5..=6).contains(&submissions), "{submissions} jobs: two pilots, two stages, new pilots");
}

#[test]
fn where_pilots_cannot_begin_every_stage_has_a_job_of_its_own() {
    let cluster = Simulated::start(4);
    cluster.failed_pilots.store(usize::MAX, Ordering::SeqCst);
    let (_lab, ran) = run_with(&cluster, 8, two_pilots());
    assert_eq!(ran.counts(), [8, 0, 0, 0, 0], "{}", ran.error());
    let submissions = cluster.submissions.load(Ordering::SeqCst);
    assert!((9..=10).contains(&submissions), "{submissions} jobs: two pilots and eight stages");
}
