//! The functions against values of high precision, against each other, and bit by bit.

use std::f64::consts::LN_2;

use proptest::prelude::*;

use super::*;

/// x, ln Γ(x), ψ(x), ψ′(x), at the double nearest to x, from mpmath 1.3 with 60 digits:
/// `python -c "import mpmath as mp; mp.mp.dps = 60; x = mp.mpf(float('0.25'));
///  print(mp.loggamma(x), mp.digamma(x), mp.polygamma(1, x))"`
const GAMMA: [(f64, f64, f64, f64); 19] = [
    (0.001, 6.907178885383853, -1000.5755719318103, 1000001.6425331958),
    (0.25, 1.2880225246980774, -4.2274535333762655, 17.19732915450711),
    (1.0, 0.0, -0.5772156649015329, 1.6449340668482264),
    (1.0000001, -5.772155829918507e-08, -0.5772155004081381, 1.6449338264368782),
    (1.4616321449683622, -0.12148629053584961, -9.241265521729427e-17, 0.9676722454476212),
    (1.9999, -4.227520877215346e-05, 0.42271983967113097, 0.6449744806987031),
    (2.0, 0.0, 0.42278433509846713, 0.6449340668482264),
    (2.5, 0.2846828704729192, 0.7031566406452432, 0.49035775610023485),
    (3.0, LN_2, 0.9227843350984671, 0.39493406684822646),
    (5.75, 4.366716036622286, 1.6597303710679365, 0.18990741193925276),
    (9.999, 12.799575780077413, 2.2516474172057355, 0.10517738667672887),
    (10.0, 12.801827480081469, 2.251752589066721, 0.10516633568168575),
    (10.001, 12.804079285251861, 2.251857749877872, 0.10515528700654396),
    (37.5, 97.52177522288821, 3.6109483445963386, 0.027025382266785015),
    (1000.0, 5905.220423209181, 6.907255195648812, 0.0010005001666666333),
    (123456.789, 1323902.0187950633, 11.723642437180377, 8.100032878799171e-06),
    (100000.0, 1051287.7089736569, 11.512920464961896, 1.0000050000166667e-05),
    (1000000.0, 12815504.569147611, 13.815510057964191, 1.0000005000001667e-06),
    (10000000.0, 151180949.3694739, 16.11809560095832, 1.0000000500000017e-07),
];

/// a, b, ln B(a, b), by `mp.loggamma(a) + mp.loggamma(b) - mp.loggamma(a + b)` with 60 digits.
const LN_BETA: [(f64, f64, f64); 13] = [
    (1.0, 1.0, 0.0),
    (1.0, 2.5, -0.9162907318741551),
    (1.0001, 1.0001, -0.00019999644960317812),
    (2.0, 3.0, -2.4849066497880004),
    (1.5, 40.0, -5.663399020169663),
    (9.9, 10.1, -13.735177544346378),
    (12.0, 12.0, -16.6020598760166),
    (1.25, 100000.0, -14.489430230130692),
    (30.0, 10000000.0, -412.28587406153883),
    (100000.0, 100000.0, -138633.92706134808),
    (123456.7, 45678.9, -98666.3418882908),
    (10000000.0, 10000000.0, -13862950.404734597),
    (10000000.0, 1.5, -24.297925751572723),
];

/// x, softplus, logistic, by `mp.log1p(mp.exp(x))` and `1 / (1 + mp.exp(-x))` with 60 digits.
const SOFTPLUS: [(f64, f64, f64); 11] = [
    (-800.0, 0.0, 0.0),
    (-50.0, 1.9287498479639178e-22, 1.9287498479639178e-22),
    (-20.0, 2.061153620314381e-09, 2.0611536181902037e-09),
    (-1.0, 0.3132616875182228, 0.2689414213699951),
    (-1e-09, 0.6931471800599454, 0.49999999975),
    (0.0, LN_2, 0.5),
    (0.5, 0.9740769841801067, 0.6224593312018546),
    (3.0, 3.048587351573742, 0.9525741268224333),
    (20.0, 20.000000002061153, 0.9999999979388464),
    (50.0, 50.0, 1.0),
    (800.0, 800.0, 1.0),
];

/// Within 1e-13 of the value, or 1e-14 of zero.
fn near(found: f64, wanted: f64) -> bool {
    (found - wanted).abs() <= 1e-13 * wanted.abs() + if wanted.abs() < 0.1 { 1e-14 } else { 0.0 }
}

#[test]
fn special_functions_equal_values_of_high_precision() {
    for (x, ln_gamma_x, digamma_x, trigamma_x) in GAMMA {
        assert!(near(ln_gamma(x), ln_gamma_x), "ln_gamma({x}) = {:e}", ln_gamma(x));
        assert!(near(digamma(x), digamma_x), "digamma({x}) = {:e}", digamma(x));
        assert!(near(trigamma(x), trigamma_x), "trigamma({x}) = {:e}", trigamma(x));
    }
    for (a, b, wanted) in LN_BETA {
        assert!(near(ln_beta(a, b), wanted), "ln_beta({a}, {b}) = {:e}", ln_beta(a, b));
        assert_eq!(ln_beta(a, b).to_bits(), ln_beta(b, a).to_bits());
    }
    for (x, wanted, slope) in SOFTPLUS {
        assert!((softplus(x) - wanted).abs() <= 4e-16 * wanted, "softplus({x}) = {:e}", softplus(x));
        assert!((logistic(x) - slope).abs() <= 4e-16 * slope, "logistic({x}) = {:e}", logistic(x));
    }
}

#[test]
fn the_gamma_family_is_not_a_number_outside_its_domain() {
    for x in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
        assert!(digamma(x).is_nan() && trigamma(x).is_nan(), "{x}");
    }
}

type Function<T> = fn(T) -> T;

/// Every function at a few inputs: what one machine gave, all must give.
#[test]
fn every_bit_is_the_same_on_every_machine() {
    let doubles: [(&str, Function<f64>); 16] = [
        ("exp", exp),
        ("exp_m1", exp_m1),
        ("ln", ln),
        ("ln_1p", ln_1p),
        ("log10", log10),
        ("sin", sin),
        ("cos", cos),
        ("tan", tan),
        ("tanh", tanh),
        ("pow", |x| pow(x, 2.7)),
        ("atan2", |x| atan2(x, -0.3)),
        ("hypot", |x| hypot(x, 1.7)),
        ("softplus", softplus),
        ("ln_gamma", ln_gamma),
        ("digamma", digamma),
        ("trigamma", trigamma),
    ];
    let singles: [(&str, Function<f32>); 8] = [
        ("expf", expf),
        ("lnf", lnf),
        ("sinf", sinf),
        ("cosf", cosf),
        ("tanhf", tanhf),
        ("atan2f", |x| atan2f(x, -0.3)),
        ("hypotf", |x| hypotf(x, 1.7)),
        ("sin_cosf", |x| sin_cosf(x).0 + sin_cosf(x).1),
    ];
    let mut found = Vec::new();
    for (name, function) in doubles {
        found.push((name, digest((1..=1000).map(|at| function(f64::from(at) * 0.013_7).to_bits()))));
    }
    for (name, function) in singles {
        found.push((name, digest((1..=1000).map(|at| function(at as f32 * 0.013_7).to_bits().into()))));
    }
    found.push((
        "ln_beta",
        digest((1..=1000).map(|at| ln_beta(1.0 + f64::from(at) * 0.037, f64::from(at * at)).to_bits())),
    ));
    assert_eq!(found, GOLDEN);
}

/// The first eight bytes of the digest of the bits.
fn digest(bits: impl Iterator<Item = u64>) -> u64 {
    let mut hasher = blake3::Hasher::new();
    bits.for_each(|bits| {
        hasher.update(&bits.to_le_bytes());
    });
    hasher.finalize().as_bytes()[..8].iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte))
}

const GOLDEN: [(&str, u64); 25] = [
    ("exp", 0xcdba_282a_16df_2cea),
    ("exp_m1", 0xec1b_5b02_98fd_9cd1),
    ("ln", 0x33de_e6c8_b1be_fc95),
    ("ln_1p", 0x503f_74d2_ffaa_50f9),
    ("log10", 0x41c9_2456_369c_1cf7),
    ("sin", 0x16e5_9fc3_c5de_d469),
    ("cos", 0x93d2_461f_d75a_8b6a),
    ("tan", 0x9f2d_9035_a995_f821),
    ("tanh", 0xa0f5_c6a4_b1fd_fd88),
    ("pow", 0x8dda_7da0_9e8c_8011),
    ("atan2", 0xa30e_370c_4590_64d4),
    ("hypot", 0x9083_c682_0ab9_1eef),
    ("softplus", 0x2d56_c11b_d57d_49e3),
    ("ln_gamma", 0x4388_9fe6_fed5_9647),
    ("digamma", 0x41d2_6868_e7c0_7083),
    ("trigamma", 0xbd50_6305_3e7d_3b70),
    ("expf", 0xb773_8e6b_1a73_b6b9),
    ("lnf", 0x3906_8f35_2173_ef31),
    ("sinf", 0x5fc7_2114_0ac0_1de4),
    ("cosf", 0x08db_657d_ae4d_407c),
    ("tanhf", 0x001d_5be6_ad86_4b11),
    ("atan2f", 0xebdb_a090_4627_ac44),
    ("hypotf", 0x4c68_517c_684e_796b),
    ("sin_cosf", 0x3ac1_7760_5e77_ea39),
    ("ln_beta", 0x1b33_c3d7_1250_bdc9),
];

/// The difference quotient over 2h.
fn slope(function: impl Fn(f64) -> f64, x: f64) -> f64 {
    let h = 1e-5 * x.abs().max(1.0);
    (function(x + h) - function(x - h)) / (2.0 * h)
}

proptest! {
    #[test]
    fn recurrences_of_the_gamma_family_hold(x in 0.01_f64..50.0) {
        prop_assert!((ln_gamma(x + 1.0) - ln_gamma(x) - ln(x)).abs() < 1e-12);
        prop_assert!((digamma(x + 1.0) - digamma(x) - 1.0 / x).abs() < 1e-13 * (1.0 + 1.0 / x));
        prop_assert!((trigamma(x + 1.0) - trigamma(x) + 1.0 / (x * x)).abs() < 1e-13 * (1.0 + 1.0 / (x * x)));
    }

    #[test]
    fn each_derivative_is_the_slope_of_its_function(x in 0.5_f64..200.0, y in -30.0_f64..30.0) {
        prop_assert!((slope(ln_gamma, x) - digamma(x)).abs() < 1e-6);
        prop_assert!((slope(digamma, x) - trigamma(x)).abs() < 1e-6);
        prop_assert!((slope(softplus, y) - logistic(y)).abs() < 1e-6);
        prop_assert!((logistic(y) + logistic(-y) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn the_logarithm_of_beta_obeys_its_recurrence(a in 1.0_f64..3e4, b in 1.0_f64..3e4) {
        // B(a + 1, b) = B(a, b) a / (a + b)
        let apart = ln_beta(a + 1.0, b) - ln_beta(a, b) - ln(a / (a + b));
        prop_assert!(apart.abs() < 1e-14 * (1.0 + ln_beta(a, b).abs()), "{apart}");
    }
}
